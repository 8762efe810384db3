import { h } from "/file/dom.js";
import { age, fixed, t, tell } from "/file/language.js";
import { give, list, press, refusal, state as stateMark } from "/file/parts.js";
import { history } from "/file/result.js";
import { source } from "/file/status.js";

const MODES = ["exact", "tilt", "lift"];
let mode = "exact";
let typed = null;
let wrong = false;

export function correct(state, again) {
  const c = state.correct;
  const r = state.result;
  const silent = source(state, "estimator").silent;
  const shown = c.modes[mode];
  return [
    h("section", { class: "wide" },
      h("p", { class: `advice ${r.advice}`, "aria-live": "polite", id: "correct-advice" }, advice(r, c, silent)),
      h("div", { class: "beside" },
        h("div", { class: "modes", role: "group", "aria-label": t("correct.mode") }, MODES.map((name) => h("button",
          { type: "button", id: `mode-${name}`, "aria-pressed": String(mode === name), onclick: () => { mode = name; again(); } }, t(`mode.${name}`)))),
        press(state, "corrected", { mode })),
      h("p", { class: "small" }, t(`mode_is.${mode}`)),
      shown ? jacks(shown, silent) : c.why ? h("p", { class: "bad" }, tell(c.why)) : null,
      shown ? list(c.remarks[mode], "missing") : null),
    h("section", { class: "wide" },
      tolerances(r),
      history(r.history),
      form(state, c, again)),
  ];
}

function advice(r, c, silent) {
  if (!r.holds) return t("correct.measure_first");
  if (silent) return t("result.stale", { age: age(r.age_s) });
  if (c.jacks.length < 3) return t("correct.no_jacks");
  return t(`advice.${r.advice}`);
}

function jacks(shown, silent) {
  return h("table", { class: `values jacks${silent ? " stale" : ""}`, id: "jacks" },
    h("thead", {}, h("tr", {}, ["correct.jack", "correct.turn", "result.uncertainty"].map((key) => h("th", { scope: "col" }, t(key))))),
    h("tbody", {}, shown.map((jack) => h("tr", { id: `jack-${jack.name}` },
      h("th", { scope: "row" }, jack.name),
      h("td", { class: "figure" }, arrow(jack.mm), ` ${fixed(jack.mm, 3, true)} mm`),
      h("td", { class: "u" }, `± ${fixed(jack.U, 4)} mm`, jack.within ? null : h("small", { class: "bad" }, t("correct.beyond_short")))))));
}

function arrow(mm) {
  const down = Number(mm.toFixed(3)) < 0;
  if (Number(mm.toFixed(3)) === 0) return "•";
  return h("span", { role: "img", "aria-label": t(down ? "correct.down" : "correct.up") }, down ? "▼" : "▲");
}

function tolerances(r) {
  const rows = r.rows.filter((row) => row.state !== null);
  if (!r.holds || !rows.length) return null;
  return h("ul", { class: "chips" }, rows.map((row) => h("li", {},
    `${row.symbol}: ${fixed(row.deviation, 4, true)} ± ${fixed(row.U, 4)} ${row.unit} `, stateMark(row.state))));
}

// Jacks typed in, where the part file has none, or others.
function form(state, c, again) {
  const rows = typed || [...c.jacks.map((j) => ({ name: j.name, x: String(j.x_mm), y: String(j.y_mm) })),
    ...Array.from({ length: Math.max(0, 3 - c.jacks.length) }, (_, at) => ({ name: `J${c.jacks.length + at + 1}`, x: "", y: "" }))];
  const edit = (at, field) => (event) => {
    typed = rows.map((row, k) => (k === at ? { ...row, [field]: event.target.value } : row));
    again();
  };
  const field = (row, at, name, mode) => h("td", {}, h("input", { value: row[name], inputmode: mode, autocomplete: "off", maxlength: 12,
    "aria-label": `${t(`correct.${name}`)} ${at + 1}`, id: `jack-${at + 1}-${name}`, oninput: edit(at, name) }));
  const off = Boolean(refusal(state, "set_jacks"));
  return h("details", { id: "type-jacks" }, h("summary", {}, t("correct.type")),
    h("table", { class: "form" },
      h("thead", {}, h("tr", {}, ["correct.name", "correct.x", "correct.y"].map((key) => h("th", { scope: "col" }, t(key))))),
      h("tbody", {}, rows.map((row, at) => h("tr", {}, field(row, at, "name", "text"), field(row, at, "x", "text"), field(row, at, "y", "text"))))),
    h("div", { class: "row" },
      h("button", { type: "button", onclick: () => { typed = [...rows, { name: `J${rows.length + 1}`, x: "", y: "" }].slice(0, 12); again(); } }, t("correct.more")),
      h("button", { type: "button", onclick: () => { typed = rows.slice(0, Math.max(3, rows.length - 1)); again(); } }, t("correct.fewer")),
      h("button", { type: "button", class: "main", id: "do-set_jacks", "aria-disabled": String(off), onclick: () => { if (!off) use(rows, again); } }, t("do.set_jacks"))),
    wrong ? h("p", { role: "alert", class: "bad" }, t("correct.no_number")) : null);
}

async function use(rows, again) {
  const read = rows.map((row) => ({ name: row.name.trim(), x_mm: parse(row.x), y_mm: parse(row.y) }));
  wrong = read.some((jack) => !jack.name || !Number.isFinite(jack.x_mm) || !Number.isFinite(jack.y_mm));
  if (!wrong) {
    await give("set_jacks", { jacks: read });
    typed = null;
  }
  again();
}

function parse(text) {
  const plain = text.trim().replace("−", "-").replace(",", ".");
  return plain === "" ? NaN : Number(plain);
}
