// How each station is, and the list of errors.

import { h } from "/file/dom.js";
import { age, clock, t, tell } from "/file/language.js";
import { link, sinceHeard } from "/file/connection.js";
import { give, refusal } from "/file/parts.js";

const MARK = { ok: "●", waiting: "○", fault: "✗", silent: "✗" };

// A station as it is now: what was heard last gets older while the server is not heard.
export function source(state, name) {
  const one = state.sources.find((s) => s.name === name);
  const older = link.lost ? sinceHeard() : 0;
  const age_s = one.age_s === null ? null : one.age_s + older;
  const word = link.lost ? "silent" : one.state;
  return { ...one, age_s, state: word, silent: word !== "ok" };
}

export function stations(state) {
  return h("ul", { class: "stations", "aria-label": t("status.stations") }, state.sources.map((s) => {
    const one = source(state, s.name);
    const old = one.state === "silent" ? ` ${age(one.age_s)}` : "";
    return h("li", { class: one.state, id: `station-${one.name}` },
      h("span", { "aria-hidden": "true" }, MARK[one.state]), ` ${t(`station.${one.name}`)}`, h("small", {}, ` ${t(`status.${one.state}`)}${old}`));
  }));
}

export function alarm(state) {
  if (link.lost) return t("status.lost", { age: age(sinceHeard()) });
  const gone = state.sources.filter((s) => s.state === "silent" || s.state === "fault");
  return gone.map((s) => `${t(`station.${s.name}`)}: ${t(`status.${s.state}`)}${s.state === "silent" ? ` (${age(s.age_s)})` : ""}${s.state === "fault" && s.detail ? ` – ${tell(s.detail)}` : ""}`).join(" · ");
}

export function troubles(state) {
  const open = state.troubles.open;
  const off = Boolean(link.lost || state.me.role !== "operator");
  const acknowledge = (number) => () => { if (!off) give("acknowledge", { number }); };
  return [
    h("section", { class: "wide", id: "troubles" },
      h("h2", {}, t("trouble.title", { n: open.length })),
      state.troubles.dropped ? h("p", {}, t("trouble.dropped", { n: state.troubles.dropped })) : null,
      open.length ? h("div", { class: "row" },
        h("button", { type: "button", id: "acknowledge-all", "aria-disabled": String(off), onclick: acknowledge(0) }, t("trouble.acknowledge_all")),
        h("button", { type: "button", onclick: () => copy(open) }, t("trouble.copy"))) : h("p", {}, t("trouble.none")),
      h("ul", { class: "troubles" }, open.map((one) => h("li", { key: `trouble-${one.number}` },
        h("p", { class: "words" }, words(one)),
        h("button", { type: "button", "aria-disabled": String(off), onclick: acknowledge(one.number) }, t("trouble.acknowledge")))))),
  ];
}

function words(one) {
  const times = one.count > 1 ? ` (${one.count}×, ${clock(one.last_ms)})` : "";
  return `${clock(one.first_ms)}${times}  ${tell(one.said)}${one.detail ? `: ${tell(one.detail)}` : ""}`;
}

function copy(open) {
  const text = open.map(words).join("\n");
  if (navigator.clipboard) { navigator.clipboard.writeText(text); return; }
  const area = document.createElement("textarea");
  area.value = text;
  document.body.appendChild(area);
  area.select();
  document.execCommand("copy");
  area.remove();
}
