// Alarms, and the log of the rover's events.

import { send } from "./net.js";
import { placeRover } from "./rover.js";
import { $, attempt, rewrite, sinceStart, state } from "./state.js";
import { duration, elapsed, element, fixed, utc, words } from "./words.js";

const ALERTS = new Set(["blocked", "safe_mode_entered", "low_energy", "plan_rejected", "round_aborted", "instrument_silent"]);
const MAX_LOGGED = 300;
const rows = new Map();

function rowOf(id) {
  const row = element("div", { role: "alert" }, element("span", { class: "kind" }), element("span", { class: "text" }),
    element("span", { class: "dim num" }), element("button", { type: "button" }, "Acknowledge"));
  row.lastChild.className = "acts-only";
  row.lastChild.addEventListener("click", () => attempt(() => send("acknowledge", { id })));
  return row;
}

// Rows stay where they are while their words change: a click or the keyboard's focus on a button outlives the change.
export function showAlarms() {
  const ids = new Set(state.alarms.map((alarm) => alarm.id));
  for (const [id, row] of rows) if (!ids.has(id)) { row.remove(); rows.delete(id); }
  state.alarms.forEach((alarm, place) => {
    const known = rows.get(alarm.id), raisedAgain = known?.classList.contains("seen") && !alarm.acknowledged;
    if (raisedAgain) known.remove();
    const row = known && !raisedAgain ? known : rowOf(alarm.id);
    rows.set(alarm.id, row);
    const [kind, text, when] = row.children;
    row.className = alarm.acknowledged ? "alarm seen" : "alarm";
    row.dataset.kind = alarm.kind;
    rewrite(kind, words(alarm.kind));
    rewrite(text, alarm.text);
    rewrite(when, `${utc(alarm.raised_at).slice(11)}${alarm.times > 1 ? `, ${alarm.times} times` : ""}${alarm.active ? "" : ", over"}`);
    if (alarm.acknowledged && row.lastChild.tagName === "BUTTON") row.lastChild.replaceWith(element("span", { class: "dim" }, "acknowledged"));
    if ($("alarms").children[place] !== row) $("alarms").insertBefore(row, $("alarms").children[place] ?? null);
  });
  placeRover();
}

export function showEvents(events) {
  $("log").replaceChildren();
  if (!events.length) $("log").append(element("li", { class: "empty dim" }, "No events yet. The log begins when the page's server joins the mission."));
  events.forEach(log);
}

export function log(event) {
  const about = [event.round ? `round ${event.round}` : "", event.sample_id ?? "", `(${fixed(event.x_m, 1)}, ${fixed(event.y_m, 1)}) m`, event.detail].filter(Boolean).join(" · ");
  const delay = (event.received_at - event.at) / 1e9;
  const item = element("li", { class: ALERTS.has(event.kind) ? "alert" : "" },
    element("span", { class: "num", title: utc(event.at) }, elapsed(sinceStart(event.at)).slice(3)), element("span", { class: "kind" }, words(event.kind)),
    element("span", {}, about, element("span", { class: "dim num" }, delay > 0 ? ` · received ${duration(delay)} later` : "")));
  $("log").querySelector("li.empty")?.remove();
  $("log").prepend(item);
  while ($("log").children.length > MAX_LOGGED) $("log").lastChild.remove();
}
