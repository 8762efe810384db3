// The server's state as it comes, commands as they go. What is shown is never older than it says.

const SILENT_MS = 2000;
const AGAIN_MS = 1000;

export const link = { state: null, heardAt: 0, lost: true, everHeard: false };
let changed = () => {};
let socket = null;

export function onChange(callback) { changed = callback; }

export function sinceHeard() { return (performance.now() - link.heardAt) / 1000; }

export function connect() {
  open();
  setInterval(look, 250);
}

async function open() {
  try {
    const answer = await fetch("/session", { cache: "no-store" });
    if (answer.status === 401) { location.assign("/"); return; }
    if (!answer.ok) throw new Error(answer.statusText);
  } catch { setTimeout(open, AGAIN_MS); return; }
  const mine = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  socket = mine;
  const start = performance.now();
  mine.onmessage = (event) => {
    if (mine !== socket) return;
    link.state = JSON.parse(event.data);
    link.heardAt = performance.now();
    link.lost = false;
    link.everHeard = true;
    changed();
  };
  const watchdog = setInterval(() => {
    if (performance.now() - Math.max(link.heardAt, start) > SILENT_MS) mine.close(), ended();
  }, 250);
  const ended = () => {
    clearInterval(watchdog);
    if (mine !== socket) return;
    socket = null;
    lose();
    setTimeout(open, AGAIN_MS);
  };
  mine.onclose = ended;
}

function look() {
  if (!link.lost && sinceHeard() * 1000 > SILENT_MS) lose();
  else if (link.lost) changed();
}

function lose() {
  link.lost = true;
  changed();
}

const under = new Map();

// One press is one command: until it is answered, and however often it is sent, its key is the same.
export function send(command, args) {
  if (under.has(command)) return under.get(command);
  const going = deliver({ command, key: newKey(), arguments: args || {} }).finally(() => { under.delete(command); changed(); });
  under.set(command, going);
  changed();
  return going;
}

export function busy(command) { return under.has(command); }

async function deliver(body) {
  for (let attempt = 0; attempt < 3; attempt += 1) {
    try {
      const answer = await fetch("/command", {
        method: "POST",
        headers: { "Content-Type": "application/json", "X-XSRFToken": cookie("_xsrf") },
        body: JSON.stringify(body),
      });
      if (answer.headers.get("Content-Type")?.includes("json")) return await answer.json();
      return { accepted: false, said: { key: "command.not_allowed", args: {}, text: answer.statusText } };
    } catch { await new Promise((done) => setTimeout(done, 500)); }
  }
  return { accepted: false, said: { key: "command.not_delivered", args: {}, text: "not delivered" } };
}

// crypto.randomUUID exists on https and localhost only.
function newKey() {
  return Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");
}

export function cookie(name) {
  return decodeURIComponent(document.cookie.split("; ").find((c) => c.startsWith(`${name}=`))?.slice(name.length + 1) || "");
}
