// The operator's page: four steps, always in sight; what is shown is the server's state.

import { h, patch } from "/file/dom.js";
import { choose, language, LANGUAGES, t, tell } from "/file/language.js";
import { connect, link, onChange } from "/file/connection.js";
import { answer } from "/file/parts.js";
import { alarm, stations, troubles } from "/file/status.js";
import { measure } from "/file/measure.js";
import { result } from "/file/result.js";
import { correct } from "/file/correct.js";
import { hand } from "/file/hand.js";

const STEPS = { measure, result, correct, hand };
const page = document.getElementById("page");
let step = location.hash.slice(1) in STEPS ? location.hash.slice(1) : "measure";

function go(name) {
  step = name;
  history.replaceState(null, "", `#${name}`);
  show();
}

function show() {
  const state = link.state;
  document.body.classList.toggle("lost", link.lost);
  if (!state) {
    patch(page, [h("main", {}, h("p", { class: "empty", role: "status" }, t("status.connecting")))]);
    return;
  }
  const wrong = alarm(state);
  const view = step === "troubles" ? troubles : STEPS[step];
  patch(page, [
    h("header", {},
      h("nav", { "aria-label": t("page.steps") }, Object.keys(STEPS).map((name, at) => h("button",
        { type: "button", id: `step-${name}`, "aria-current": step === name ? "step" : null, onclick: () => go(name) },
        h("span", { class: "count" }, at + 1), ` ${t(`step.${name}`)}`)))),
    h("div", { class: wrong ? "line alarm" : "line" },
      h("p", { id: "alarm", role: "alert" }, wrong),
      h("p", { id: "answer", class: answer.accepted ? "good" : "bad", "aria-live": "polite" }, answer.said ? tell(answer.said) : "")),
    h("main", { key: step, id: step, class: link.lost ? "stale" : "", tabindex: -1 },
      h("h1", { class: "hidden" }, t(step === "troubles" ? "trouble.title" : `step.${step}`, { n: state.troubles.open.length })), view(state, show)),
    h("footer", {},
      h("button", { type: "button", id: "step-troubles", class: state.troubles.open.length ? "bad" : "", "aria-current": step === "troubles" ? "page" : null, onclick: () => go("troubles") },
        t("trouble.button", { n: state.troubles.open.length })),
      stations(state),
      h("label", {}, h("span", { class: "hidden" }, t("page.language")),
        h("select", { id: "language", onchange: (event) => speak(event.target.value) }, Object.entries(LANGUAGES).map(([name, label]) =>
          h("option", { value: name, lang: name, selected: name === language }, label)))))]);
}

async function speak(name) {
  localStorage.setItem("language", name);
  await choose(name);
  show();
}

// What the node says is its language counts until somebody chooses one here.
let greeted = false;
onChange(async () => {
  if (!greeted && link.state) {
    greeted = true;
    const chosen = localStorage.getItem("language");
    await choose(chosen in LANGUAGES ? chosen : link.state.me.language);
  }
  show();
});
const first = localStorage.getItem("language");
await choose(first in LANGUAGES ? first : "en");
show();
connect();
