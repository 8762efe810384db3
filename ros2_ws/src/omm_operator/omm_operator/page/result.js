import { h } from "/file/dom.js";
import { age, clock, fixed, language, t, tell } from "/file/language.js";
import { bar, list, press, state as stateMark } from "/file/parts.js";
import { source } from "/file/status.js";

const DIGITS = 4;

export function result(state) {
  const r = state.result;
  const silent = source(state, "estimator").silent;
  return [
    h("section", { class: "wide" },
      h("p", { class: `advice ${r.advice}`, "aria-live": "polite", id: "advice" }, headline(r, silent)),
      r.holds ? values(r, silent) : list(state.measure.missing, "missing")),
    h("section", { class: "wide" },
      r.findings?.length ? [h("h2", {}, t("result.findings")), list(r.findings, "missing")] : null,
      r.holds ? h("p", { class: "small" }, t("result.fit", { rms: fixed(r.rms_px, 4), sigma: fixed(r.sigma0, 3), dof: r.degrees_of_freedom, model: r.model })) : null,
      shares(r),
      history(r.history),
      h("div", { class: "row" }, press(state, "make_report", { language }), report(state.report))),
  ];
}

function headline(r, silent) {
  if (r.revoked) return t("result.revoked", { why: tell(r.revoked_reason) });
  if (!r.holds) return t("result.none");
  const old = silent ? ` ${t("result.stale", { age: age(r.age_s) })}` : "";
  return t(`advice.${r.advice}`) + old;
}

function values(r, silent) {
  return h("table", { class: `values${silent ? " stale" : ""}`, id: "values" },
    h("caption", {}, t("result.caption", { age: age(r.age_s), clamping: r.clamping + 1 })),
    h("thead", {}, h("tr", {}, ["result.quantity", "result.value", "result.uncertainty", "result.tolerance"]
      .map((key) => h("th", { scope: "col" }, t(key))))),
    h("tbody", {}, r.rows.map((row) => h("tr", { id: `row-${row.key}` },
      h("th", { scope: "row" }, row.symbol),
      h("td", { class: "figure" }, fixed(row.value, DIGITS)),
      h("td", { class: "u" }, `± ${fixed(row.U, DIGITS)} ${row.unit}`),
      h("td", { class: "decided" }, row.state === null ? "" : [
        h("span", {}, `${fixed(row.nominal, DIGITS)} ± ${fixed(row.tolerance, DIGITS)}`), " ", stateMark(row.state),
        row.well || row.state === "inside" ? null : h("small", {}, ` ${t("result.measure_better")}`), bar(row)])))));
}

function shares(r) {
  const sources = Object.entries(r.shares || {});
  if (!sources.length) return null;
  return h("table", { class: "shares" }, h("caption", {}, t("result.shares")),
    h("thead", {}, h("tr", {}, h("th", { scope: "col" }, t("result.source")), r.symbols.map((symbol) => h("th", { scope: "col" }, symbol)))),
    h("tbody", {}, sources.map(([name, of]) => h("tr", {}, h("th", { scope: "row" }, t(`share.${name}`)),
      of.map((share) => h("td", {}, share === null ? "–" : `${fixed(100 * share, 1)} %`))))));
}

export function history(entries) {
  if (entries.length < 2) return null;
  return h("table", { class: "history", id: "history" }, h("caption", {}, t("result.history")),
    h("thead", {}, h("tr", {}, h("th", { scope: "col" }, t("result.when")), entries[0].rows.map((row) => h("th", { scope: "col" }, `${row.symbol} (${row.unit})`)), h("th", { scope: "col" }, t("result.jacks")))),
    h("tbody", {}, entries.map((entry) => h("tr", {}, h("th", { scope: "row" }, clock(entry.time_ms)),
      entry.rows.map((row) => h("td", {}, fixed(row.value, DIGITS))),
      h("td", {}, entry.jacks.map((jack) => `${jack.name} ${fixed(jack.mm, 3, true)}`).join("  "))))));
}

function report(r) {
  return h("div", { class: "command" },
    r.number > 0 ? h("a", { class: "button", href: `/report.pdf?number=${r.number}`, target: "_blank", rel: "noopener", id: "report" }, t("report.open")) : null,
    h("p", { class: "why", "aria-live": "polite" }, r.state === "none" || r.state === "ready" ? "" : t(`report.${r.state}`)));
}
