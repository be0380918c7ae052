// The log: its newest lines, chosen by kind and text, and what is chosen as a file.

import { redraw } from "./frames.js";
import { KINDS, asCsv, asJson, chosen, logLines } from "./loglines.js";
import { save } from "./net.js";
import { $, rewrite, sinceStart, state } from "./state.js";
import { duration, elapsed, element, grouped, utc, words } from "./words.js";

const MAX_SHOWN = 300, EVERY_MS = 450;
let writtenAt = -Infinity;
let shown = []; // the keys of the lines that are shown, oldest first

const kinds = () => new Set([...$("log-kinds").querySelectorAll("input:checked")].map((input) => input.value));
const seen = () => chosen(logLines({ ...state, commands: state.commands.values() }), kinds(), $("log-text").value);

const keyOf = ({ at, known_at, kind, name, text }) => `${at} ${known_at} ${kind} ${name} ${text}`;

// The log changes with nearly every message; it is written twice a second at most.
export function showLog() {
  if (performance.now() - writtenAt < EVERY_MS) { redraw(showLog); return; }
  writtenAt = performance.now();
  write();
}

// A line that has been written stays where it is: mostly there are only new ones.
function write() {
  const lines = seen(), newest = lines.slice(-MAX_SHOWN), keys = newest.map(keyOf);
  const first = shown.indexOf(keys[0]), kept = first < 0 ? 0 : shown.length - first;
  rewrite($("log-count"), `${grouped(lines.length)} ${lines.length === 1 ? "line" : "lines"}${lines.length > MAX_SHOWN ? `, the newest ${MAX_SHOWN} shown` : ""}`);
  if (kept > 0 && kept <= keys.length && shown.slice(first).every((key, index) => key === keys[index])) {
    $("log").prepend(...newest.slice(kept).reverse().map(row));
    while ($("log").children.length > keys.length) $("log").lastChild.remove();
  } else {
    $("log").replaceChildren(...newest.reverse().map(row));
    if (!lines.length) $("log").append(element("li", { class: "empty dim" }, "No lines of that choice."));
  }
  shown = keys;
}

function row({ at, known_at, kind, name, text, by, alert }) {
  const late = (known_at - at) / 1e9;
  return element("li", { class: alert ? "alert" : "", "data-kind": kind },
    element("span", { class: "num", title: utc(at) }, elapsed(sinceStart(at)).slice(3)), element("span", { class: "source dim" }, kind),
    element("span", { class: "kind" }, words(name)),
    element("span", {}, text, element("span", { class: "dim num" }, `${by ? ` · by ${by}` : ""}${late > 0 ? ` · received ${duration(late)} later` : ""}`)));
}

$("log-kinds").append(...KINDS.map((kind) => element("label", {}, element("input", { type: "checkbox", value: kind, checked: true }), element("span", {}, kind))));
for (const id of ["log-kinds", "log-text"]) $(id).addEventListener("input", write);
const file = (ending) => `${$("mission").textContent}-log.${ending}`;
$("log-csv").addEventListener("click", () => save(file("csv"), "text/csv", asCsv(seen())));
$("log-json").addEventListener("click", () => save(file("json"), "application/json", asJson(seen())));
