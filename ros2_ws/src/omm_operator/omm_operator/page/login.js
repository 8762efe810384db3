import { h, patch } from "/file/dom.js";
import { choose, t } from "/file/language.js";
import { cookie } from "/file/connection.js";

const known = ["en", "de", "es", "eu"];
const wanted = (navigator.language || "en").slice(0, 2);
let told = "";

async function enter(event) {
  event.preventDefault();
  const answer = await fetch("/login", {
    method: "POST",
    headers: { "Content-Type": "application/x-www-form-urlencoded", "X-XSRFToken": cookie("_xsrf") },
    body: new URLSearchParams({ token: document.getElementById("token").value }),
  });
  if (answer.ok) location.assign("/");
  else { told = answer.status === 429 ? "login.locked" : "login.wrong"; show(); }
}

function show() {
  patch(document.getElementById("page"), [
    h("h1", {}, t("login.title")),
    h("form", { onsubmit: enter },
      h("label", { for: "token" }, t("login.token")),
      h("input", { id: "token", autocomplete: "off", spellcheck: "false", autocapitalize: "none", autofocus: true }),
      h("button", { class: "main", type: "submit" }, t("login.enter"))),
    h("p", { role: "alert" }, told ? t(told) : ""),
  ]);
}

await choose(known.includes(wanted) ? wanted : "en");
show();
