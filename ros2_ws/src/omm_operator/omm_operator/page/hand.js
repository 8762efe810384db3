import { h } from "/file/dom.js";
import { clock, fixed, t, tell } from "/file/language.js";
import { hold, list, press } from "/file/parts.js";
import { link } from "/file/connection.js";

const OTHER = { opcua: "OPC UA" };
const CONTROLS = { linuxcnc: "LinuxCNC", siemens: "Siemens", heidenhain: "Heidenhain", fanuc: "Fanuc", fagor: "Fagor" };
const AXES = ["X", "Y", "Z", "A", "B", "C"];

export function hand(state) {
  const d = state.hand;
  const holds = state.result.holds;
  return [
    h("section", {},
      h("h2", {}, t("hand.to", { control: CONTROLS[d.control] || OTHER[d.control], offset: d.offset })),
      d.why ? h("p", { class: "bad", role: "alert", id: "hand-why" }, tell(d.why)) : null,
      offsets(d)),
    h("section", {},
      h("div", { class: "row" }, hold(state, "hand_over"), press(state, "read_offset")),
      h("div", { "aria-live": "polite", id: "handed" }, handed(d.handed)),
      h("ul", { class: "conditions", id: "conditions" }, d.conditions.map((one) => h("li", { class: one.holds && !link.lost ? "good" : "bad", id: `condition-${one.name}` },
        `${one.holds && !link.lost ? "✓" : "✗"} ${one.holds ? t(`condition.${one.name}`) : tell(one.why)}`)))),
    h("section", { class: "wide" },
      d.words.length ? [h("h2", {}, t("hand.words")), h("pre", { tabindex: 0, id: "words" }, d.words.join("\n"))] : null,
      d.error_mm === null ? null : h("p", { class: "small" }, t("hand.error", { mm: fixed(d.error_mm, 4), allowed: fixed(d.remaining_mm, 3) })),
      d.unconfirmed.length ? [h("p", { class: "small" }, t("hand.confirm")), list(d.unconfirmed, "small")] : null,
      h("h2", {}, t("hand.files")),
      holds ? h("div", { class: "row files" }, Object.entries(CONTROLS).map(([name, label]) =>
        h("a", { class: "button", href: `/handover/${name}`, download: true, id: `file-${name}` }, label))) : h("p", {}, t("hand.no_pose"))),
  ];
}

function numbers(offset) {
  return offset ? [...offset.xyz_mm, ...offset.angles_deg] : [];
}

function offsets(d) {
  if (!d.new && !d.old) return null;
  const old = numbers(d.old);
  const wanted = numbers(d.new);
  return h("table", { class: "values offsets", id: "offsets" },
    h("thead", {}, h("tr", {}, ["hand.axis", "hand.old", "hand.new", "hand.change"].map((key) => h("th", { scope: "col" }, t(key))))),
    h("tbody", {}, AXES.map((axis, k) => k > 2 && d.control === "linuxcnc" && k < 5 ? null : h("tr", {},
      h("th", { scope: "row" }, k === 5 && d.control === "linuxcnc" ? "R" : axis),
      h("td", {}, fixed(old[k], 4)), h("td", { class: "new" }, fixed(wanted[k], k < 3 ? 4 : 6)),
      h("td", {}, old.length && wanted.length ? `${fixed(wanted[k] - old[k], 4, true)} ${k < 3 ? "mm" : "°"}` : "–")))));
}

function handed(done) {
  if (!done) return null;
  return h("p", { class: done.equal ? "good" : "bad" },
    `${done.equal ? "✓" : "✗"} ${t(done.equal ? "hand.equal" : "hand.differs", { time: clock(done.time_ms), offset: done.new.name })}`);
}
