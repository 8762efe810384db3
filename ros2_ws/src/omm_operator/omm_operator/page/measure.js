import { h } from "/file/dom.js";
import { age, clock, fixed, t, tell } from "/file/language.js";
import { hold, list, press } from "/file/parts.js";
import { source } from "/file/status.js";

const LARGEST_ENLARGEMENT = 2000;

export function measure(state) {
  const m = state.measure;
  return [
    h("section", { class: "picture", "aria-label": t("measure.picture") }, picture(m.picture, source(state, "camera"))),
    h("section", { class: "side" },
      h("p", { class: "big", "aria-live": "polite", id: "stop" },
        m.stops ? t("measure.stop_of", { k: m.stop, n: m.stops }) : t("measure.stop", { k: m.stop })),
      h("p", { id: "program" }, program(m.control, source(state, "control"))),
      m.part ? h("p", {}, t("measure.part", { part: m.part, clamping: m.clamping + 1 })) : null,
      m.part_why ? h("p", { class: "bad" }, `${t("measure.part_file")} ${tell(m.part_why)}`) : null,
      h("div", { class: "row" }, hold(state, "start_program"), press(state, "new_clamping")),
      h("div", { "aria-live": "polite", id: "missing" },
        m.missing.length ? [h("h2", {}, t("measure.missing")), list(m.missing, "missing")] : null),
      m.pending ? h("p", {}, t("measure.pending", { n: m.pending })) : null,
      refused(m.refused, m.images),
      targets(m)),
  ];
}

function program(control, from) {
  if (!control) return t("measure.no_control");
  const word = from.silent ? t("measure.control_silent", { age: age(from.age_s) }) : t(`program.${control.program_state}`);
  const where = control.program ? ` · ${control.program}${control.line >= 0 ? ` : ${control.line}` : ""}` : "";
  const still = control.in_position ? t("measure.in_position") : t("measure.moving");
  return h("span", { class: from.silent ? "stale" : "" }, `${word}${where} · ${still}`);
}

function refused(bad, of) {
  if (!bad.length) return null;
  return h("div", { id: "refused" }, h("h2", {}, t("measure.refused")),
    h("ul", { class: "missing" }, [...bad].reverse().map((image) => h("li", {}, `${t("measure.image", { n: image.number, of })}: ${tell(image.why)}`))));
}

function targets(m) {
  if (!m.targets.length) return null;
  return h("div", {}, h("h2", {}, t("measure.targets", { used: m.used, n: m.images })),
    h("ul", { class: "chips" }, m.targets.map(([id, count]) => h("li", { class: count >= 2 ? "good" : count ? "some" : "none" },
      `${id}: ${count}×${count >= 2 ? " ✓" : count ? "" : " ✗"}`))));
}

function picture(p, camera) {
  if (!p) return h("p", { class: "empty" }, t("measure.no_picture"));
  const largest = Math.max(0, ...p.targets.map((one) => one.residual ? Math.hypot(...one.residual) : 0));
  const unit = p.width / 100;
  const times = largest > 0 ? Math.min(LARGEST_ENLARGEMENT, 10 ** Math.floor(Math.log10(8 * unit / largest))) : 0;
  return [
    h("figure", { class: camera.silent ? "stale" : "" },
      h("img", { src: `/picture.jpg?number=${p.number}`, alt: t("measure.picture_alt", { n: p.targets.length }), width: p.width, height: p.height }),
      h("svg", { viewBox: `0 0 ${p.width} ${p.height}`, "aria-hidden": "true" },
        p.refused.map((one) => h("path", { class: "refused", "stroke-width": unit * 0.3,
          d: `M${one.col - unit} ${one.row - unit}l${2 * unit} ${2 * unit}m0 ${-2 * unit}l${-2 * unit} ${2 * unit}` })),
        p.targets.map((one) => [
          h("circle", { class: one.used === false ? "refused" : "found", cx: one.col, cy: one.row, r: unit * 1.6, "stroke-width": unit * 0.3 }),
          h("text", { x: one.col + unit * 2, y: one.row - unit * 1.2, "font-size": unit * 3.2, "stroke-width": unit * 0.5 }, one.id),
          one.residual && times ? h("line", { class: "residual", x1: one.col, y1: one.row, "stroke-width": unit * 0.35,
            x2: one.col - times * one.residual[0], y2: one.row - times * one.residual[1] }) : null,
        ]))),
    h("p", { class: "caption" }, [
      p.at ? `${t("measure.image", { n: p.at, of: p.of })} · ` : "",
      t("measure.picture_of", { time: clock(p.time_ms), n: p.targets.length }),
      times ? ` · ${t("measure.enlarged", { times, px: fixed(largest, 3) })}` : "",
      camera.silent ? ` · ${t("status.age", { age: age(camera.age_s) })}` : "",
    ].join("")),
    reasons(p),
  ];
}

function reasons(p) {
  const out = p.targets.filter((one) => one.used === false && one.why).map((one) => `${one.id}: ${tell(one.why)}`);
  const counted = new Map();
  for (const one of p.refused) counted.set(tell(one.why), (counted.get(tell(one.why)) || 0) + 1);
  const told = [...out, ...[...counted].map(([why, n]) => `${n}× ${why}`)];
  return told.length ? h("ul", { class: "missing", id: "refused-targets" }, told.map((words) => h("li", {}, words))) : null;
}
