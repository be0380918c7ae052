// The command stack: its text is checked here, and sent by the server, which goes on without this page.

import { look } from "./deliberate.js";
import { map } from "./layers.js";
import { send } from "./net.js";
import { $, attempt, rewrite, state, toast } from "./state.js";
import { element, words } from "./words.js";

const MOST_CHARACTERS = 60_000;
const SHOWN = new Set(["does", "drive", "energy", "closes", "opens", "rounds", "REFUSED", "WARNING", "now"]); // of what a command would do
const ALERTS = new Set(["REFUSED", "WARNING"]), FAILED = new Set(["rejected", "failed", "expired", "lost"]);
let checked = null; // the text that was checked and may be sent
let list = "run"; // what the list shows: "run" for the stack that is or was under way, "check", or "none"

const isUnderWay = () => state.stack !== null && !state.stack.ended;

// Does it; what fails is told in the panel, and stays until the operator goes on.
async function tried(what) {
  try { await what(); } catch (error) {
    showStack();
    rewrite($("stack-failure"), error.message);
  }
}

// --- the text -------------------------------------------------------------------------------------------------------

$("stack-text").value = sessionStorage.getItem("stack") ?? ""; // a reload forgets nothing
function textChanged() {
  sessionStorage.setItem("stack", $("stack-text").value);
  if (!isUnderWay()) clear("none"); // the list was of another text
  showStack();
}

function clear(next) {
  checked = null;
  list = next;
  delete $("stack-lines").dataset.key;
  $("stack-lines").replaceChildren();
  rewrite($("stack-failure"), "");
}

$("stack-text").addEventListener("input", textChanged);
$("stack-text").addEventListener("keydown", (event) => { if (event.key === "Enter" && (event.ctrlKey || event.metaKey)) { event.preventDefault(); tried(check); } });

$("stack-open").addEventListener("click", () => $("stack-file").click());
$("stack-file").addEventListener("change", () => attempt(async () => {
  const [file] = $("stack-file").files;
  $("stack-file").value = ""; // the same file can be opened again
  if (!file) return;
  const text = file.size > MOST_CHARACTERS ? null : await file.text();
  if (text === null || text.length > MOST_CHARACTERS) throw new Error(`${file.name}: expected at most 60,000 characters, got more`);
  if (text.includes("\uFFFD") || text.includes("\0")) throw new Error(`${file.name}: expected a text in UTF-8, got something else`);
  $("stack-text").value = text;
  textChanged();
}));

// --- the check ------------------------------------------------------------------------------------------------------

async function check() {
  const text = $("stack-text").value;
  clear("none");
  showStack();
  const { lines, error } = await send("stack/check", { text });
  if (text !== $("stack-text").value || isUnderWay()) return;
  $("stack-lines").replaceChildren(...lines.map((line) => row(line, [told(line.rows)])));
  rewrite($("stack-failure"), error);
  checked = error ? null : text;
  list = "check";
  showStack();
}
$("stack-check").addEventListener("click", () => tried(check));

function row({ line, command, waits_for }, about, look = "") {
  return element("li", { class: look, "data-line": line }, element("div", { class: "head" }, command, element("span", { class: "dim num" }, `line ${line}, ${waits_for}`)), ...about);
}

const told = (rows) => element("table", { class: "result num" }, element("tbody", {}, ...rowsOf(rows)));
const rowsOf = (rows) => rows.filter(([name]) => SHOWN.has(name)).map(([name, text]) => (
  element("tr", { class: ALERTS.has(name) ? "alert" : "" }, element("th", { scope: "row" }, name.toLowerCase()), element("td", {}, text))));

// --- the stack that is under way ------------------------------------------------------------------------------------

// A stack as the server tells it; null if there was none.
export function takeStack(stack) {
  if (stack && state.stack?.number === stack.number && stack.serial < state.stack.serial) return; // the stream was faster
  const wasUnderWay = isUnderWay();
  state.stack = stack;
  if (isUnderWay() && list !== "run") clear("run");
  if (!stack && list === "run") {
    clear("none");
    if (wasUnderWay) rewrite($("stack-failure"), "The stack has ended with the page's server, which was started anew; Commands has what was sent");
  }
  showStack();
}

function note(stack) {
  if (list === "check") return checked === null ? "refused; nothing was sent" : "checked; nothing is sent yet";
  if (list !== "run" || !stack) return "";
  const of = `${stack.lines.filter(({ ended }) => ended).length} of ${stack.lines.length} completed`;
  return stack.ended ? (stack.failure ? "stopped" : `done, ${of}`) : `under way, ${of}, sent by ${stack.by}`;
}

function showStack() {
  const { stack } = state, busy = isUnderWay();
  $("stack-check").disabled = busy || $("stack-text").value.trim() === "";
  $("stack-send").disabled = busy || checked === null;
  $("stack-stop").disabled = !busy;
  rewrite($("stack-note"), note(stack));
  if (stack && list === "run") showLines(stack);
  showQuestion(busy ? stack.asks : null);
  look();
}

function showLines({ lines, failure, number }) {
  const key = JSON.stringify([number, lines, failure]);
  if ($("stack-lines").dataset.key === key) return;
  $("stack-lines").dataset.key = key;
  $("stack-lines").replaceChildren(...lines.map((line) => {
    const bad = FAILED.has(line.stage), stage = line.stage ?? "not sent";
    return row(line, [element("ol", { class: "stages num" }, element("li", { class: bad ? "bad" : line.stage === "completed" ? "good" : "" }, words(stage)))], bad ? "failed" : line.ended ? "done" : line.stage ? "open" : "");
  }));
  rewrite($("stack-failure"), failure);
}

let asked = ""; // the question that is shown
function showQuestion(asks) {
  const key = asks ? `${state.stack.number} ${asks.line}` : "";
  if (key === asked) return;
  if (asked) { map.preview = null; map.draw(); }
  asked = key;
  $("stack-asks").hidden = !asks;
  if (!asks) return;
  const { command } = state.stack.lines.find(({ line }) => line === asks.line);
  rewrite($("stack-asks-title"), `Line ${asks.line} waits for your answer: ${command}`);
  $("stack-asks-rows").replaceChildren(...rowsOf(asks.rows));
  map.preview = asks.path_m.length ? asks.path_m : null;
  map.draw();
}

const answer = (sends) => tried(async () => {
  const { number, asks } = state.stack;
  takeStack((await send("stack/answer", { number, line: asks.line, send: sends })).stack);
});
$("stack-yes").addEventListener("click", () => answer(true));
$("stack-no").addEventListener("click", () => answer(false));
$("stack-send").addEventListener("click", () => tried(async () => {
  const text = checked;
  $("stack-send").disabled = true;
  takeStack((await send("stack", { text, step: $("stack-step").checked })).stack);
  toast("Command stack begun");
}));
$("stack-stop").addEventListener("click", () => tried(async () => {
  takeStack((await send("stack/stop", { number: state.stack.number })).stack);
}));
