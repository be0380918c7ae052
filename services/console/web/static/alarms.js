// Alarms: what needs attention first, with who has seen or shelved it. What is over is in the log.

import { look } from "./deliberate.js";
import { send } from "./net.js";
import { placeRover } from "./rover.js";
import { $, attempt, rewrite, state, toast } from "./state.js";
import { element, utc, words } from "./words.js";

const SHELVED_FOR_S = 3600;
const rows = new Map(); // kind -> its row; there is one alarm of a kind at most
const ACTIONS = { acknowledge: "Acknowledge", shelve: "Shelve for 1 h", unshelve: "Unshelve" };

function rowOf(kind) {
  const buttons = Object.entries(ACTIONS).map(([action, text]) => {
    const button = element("button", { type: "button", class: `acts-only ${action}${action === "acknowledge" ? "" : " ghost"}` }, text);
    button.addEventListener("click", () => attempt(() => mark(kind, action)));
    return button;
  });
  return element("div", { role: "alert" }, element("span", { class: "severity" }), element("span", { class: "kind" }, words(kind)),
    element("span", { class: "text" }), element("span", { class: "when dim num" }), element("span", { class: "seen-by dim" }), ...buttons);
}

async function mark(kind, action) {
  const { done } = await send("alarm", { kind, action, ...(action === "shelve" ? { shelve_s: SHELVED_FOR_S } : {}) });
  if (!done) toast(`The alarm ${words(kind)} is no longer there`, true);
}

function when({ raised_at, ended_at, times }) {
  const again = times > 1 ? `, ${times} times` : "";
  return `${ended_at ? "" : "since "}${utc(raised_at)}${ended_at ? ` to ${utc(ended_at).slice(11)}` : ""}${again}`;
}

function seenBy(alarm) {
  const shelved = alarm.shelved_until ? `shelved until ${utc(alarm.shelved_until)} by ${alarm.shelved_by}` : "";
  return shelved || (alarm.acknowledged ? `acknowledged ${utc(alarm.acknowledged_at).slice(11)} by ${alarm.acknowledged_by}` : "");
}

// Rows stay where they are while their words change: a click or the keyboard's focus on a button outlives the change.
export function showAlarms() {
  const { current } = state.alarms, kinds = new Set(current.map((alarm) => alarm.kind));
  for (const [kind, row] of rows) if (!kinds.has(kind)) { row.remove(); rows.delete(kind); }
  current.forEach((alarm, place) => {
    const seen = alarm.acknowledged || alarm.shelved_until !== null, known = rows.get(alarm.kind);
    const row = known ?? rowOf(alarm.kind);
    rows.set(alarm.kind, row);
    row.className = `alarm ${alarm.severity}${seen ? " seen" : ""}${alarm.active ? "" : " over"}`;
    row.dataset.kind = alarm.kind;
    const [severity, , text, at, by] = row.children;
    rewrite(severity, alarm.active ? alarm.severity : `${alarm.severity}, over`);
    rewrite(text, alarm.text);
    rewrite(at, when(alarm));
    rewrite(by, seenBy(alarm));
    row.querySelector(".acknowledge").hidden = alarm.acknowledged;
    row.querySelector(".shelve").hidden = alarm.shelved_until !== null;
    row.querySelector(".unshelve").hidden = alarm.shelved_until === null;
    if ($("alarms").children[place] !== row) $("alarms").insertBefore(row, $("alarms").children[place] ?? null);
  });
  look(); // the buttons of other rows may have moved
  placeRover();
}
