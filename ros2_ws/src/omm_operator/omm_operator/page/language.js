// Words by key, numbers as the language writes them.

const COMMA = new Set(["de", "es", "eu"]);
export const LANGUAGES = { en: "English", de: "Deutsch", es: "Español", eu: "Euskara" };
const AGAIN_MS = 1000;
let words = {};
let between = []; // English words within arguments, and ours
let english = null;
export let language = "en";

let wanted = "en"; // the last choice counts, however long an earlier one takes

export async function choose(name) {
  wanted = name;
  const chosen = await delivered(name);
  english ||= await delivered("en");
  if (!chosen || !english || wanted !== name) return;
  words = chosen;
  between = name === "en" ? [] : Object.keys(english).filter((key) => key.startsWith("word."))
    .sort((a, b) => english[b].length - english[a].length)
    .map((key) => [new RegExp(`\\b${english[key]}\\b`, "g"), words[key]]);
  language = name;
  document.documentElement.lang = name;
}

// While the node is away, the words come when it is back.
async function delivered(name) {
  for (;;) {
    try {
      const answer = await fetch(`/language/${name}.json`);
      return answer.ok ? await answer.json() : null;
    } catch { await new Promise((done) => setTimeout(done, AGAIN_MS)); }
  }
}

export function t(key, args) {
  const template = words[key];
  if (template === undefined) return key;
  return template.replace(/\{([a-zA-Z_]+)\}/g, (_, name) => argument(key, args?.[name] ?? ""));
}

// An argument is text, or something said: words in words.
function argument(key, value) {
  if (typeof value === "object") return tell(value);
  const text = String(value);
  return key === "said.verbatim" ? text : decimal(between.reduce((t, [from, to]) => t.replace(from, to), text));
}

// What the server says: its key, else its English text.
export function tell(said) {
  if (!said) return "";
  return said.key in words ? t(said.key, said.args) : said.text;
}

export function decimal(text) {
  return COMMA.has(language) ? text.replace(/(?<![\d.])([+-]?\d+)\.(\d+)(?![\d.])/g, "$1,$2") : text;
}

export function fixed(value, digits, sign) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const text = value.toFixed(digits);
  const plain = Number(text) === 0 ? text.replace("-", "") : text;
  return decimal((sign && Number(text) > 0 ? "+" : "") + plain).replace("-", "−");
}

export function age(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  if (seconds < 120) return t("age.seconds", { n: Math.floor(seconds) });
  if (seconds < 7200) return t("age.minutes", { n: Math.floor(seconds / 60) });
  return t("age.hours", { n: Math.floor(seconds / 3600) });
}

export function clock(ms) {
  const at = new Date(ms);
  return [at.getHours(), at.getMinutes(), at.getSeconds()].map((n) => String(n).padStart(2, "0")).join(":");
}
