// What several steps are made of: buttons that are pressed or held, lists, tolerance bars.

import { h } from "/file/dom.js";
import { fixed, t, tell } from "/file/language.js";
import { busy, link, send } from "/file/connection.js";

const HOLD_MS = 1000;
const DONE_MS = 10000;
export const answer = { command: null, said: null, accepted: true };

export function refusal(state, command) {
  if (link.lost) return t("command.lost");
  if (state.me.role !== "operator") return t("command.only_viewer");
  return tell(state.commands[command]);
}

export async function give(command, args) {
  const got = await send(command, args);
  const mine = { command, said: got.said, accepted: got.accepted };
  Object.assign(answer, mine);
  // What was done needs no more looking at after a while; what was refused stays.
  if (got.accepted) setTimeout(() => { if (answer.said === mine.said) answer.said = null; }, DONE_MS);
}

// Pressed once. Why it is off stands below it.
export function press(state, command, args, props) {
  const why = refusal(state, command);
  const off = Boolean(why) || busy(command);
  return h("div", { class: "command" },
    h("button", { type: "button", class: "main", id: `do-${command}`, "aria-disabled": String(off),
      "aria-describedby": `why-${command}`, onclick: () => { if (!off) give(command, args); }, ...props }, t(`do.${command}`)),
    h("p", { class: "why", id: `why-${command}` }, why || (busy(command) ? t("command.under_way") : "")));
}

// Held for a second: for what moves the machine or writes to the control.
let holding = null;
export function hold(state, command, args) {
  const why = refusal(state, command);
  const off = Boolean(why) || busy(command);
  if (off && holding?.command === command) release();
  const begin = (event) => {
    if (off || holding || (event.type === "keydown" && event.key !== " " && event.key !== "Enter")) return;
    event.preventDefault();
    const button = event.currentTarget;
    button.classList.add("holding");
    holding = { command, button, timer: setTimeout(() => { release(); give(command, args); }, HOLD_MS) };
  };
  return h("div", { class: "command" },
    h("button", { type: "button", class: "main hold", id: `do-${command}`, "aria-disabled": String(off), "aria-describedby": `why-${command}`,
      onpointerdown: begin, onpointerup: release, onpointerleave: release, onpointercancel: release,
      onkeydown: begin, onkeyup: release, onblur: release, oncontextmenu: (event) => event.preventDefault() },
      h("span", {}, t(`do.${command}`)), h("small", {}, t("command.hold"))),
    h("p", { class: "why", id: `why-${command}` }, why || (busy(command) ? t("command.under_way") : "")));
}

function release() {
  if (!holding) return;
  clearTimeout(holding.timer);
  holding.button.classList.remove("holding");
  holding = null;
}

export function list(saids, kind) {
  return saids.length ? h("ul", { class: kind }, saids.map((said) => h("li", {}, tell(said)))) : null;
}

const MARK = { inside: "✓", "not proven": "?", outside: "✗" };
const NAME = { inside: "state.inside", "not proven": "state.not_proven", outside: "state.outside" };

export function state(name) {
  return name ? h("span", { class: `state ${name.replace(" ", "-")}` }, `${MARK[name]} ${t(NAME[name])}`) : null;
}

// Tolerance (the grey field), value (the line) and U (the bar about it).
export function bar(row) {
  if (row.state === null) return null;
  const reach = Math.max(row.tolerance * 1.5, Math.min(Math.abs(row.deviation) + row.U, row.tolerance * 6));
  const x = (value) => 100 * Math.max(-1, Math.min(1, value / reach));
  const low = x(row.deviation - row.U);
  const high = x(row.deviation + row.U);
  const words = `${fixed(row.deviation, 4, true)} ± ${fixed(row.U, 4)} ${row.unit}, ± ${fixed(row.tolerance, 4)}`;
  return h("svg", { class: `bar ${row.state.replace(" ", "-")}`, viewBox: "-101 -10 202 20", preserveAspectRatio: "none", role: "img", "aria-label": words },
    h("rect", { class: "field", x: x(-row.tolerance), y: -10, width: x(row.tolerance) - x(-row.tolerance), height: 20 }),
    h("line", { class: "zero", x1: 0, x2: 0, y1: -10, y2: 10 }),
    h("rect", { class: "range", x: low, y: -5, width: Math.max(0.8, high - low), height: 10 }),
    h("line", { class: "value", x1: x(row.deviation), x2: x(row.deviation), y1: -9, y2: 9 }));
}
