// The link's panel: messages in flight, counts, and the form that changes the conditions.

import { look } from "./deliberate.js";
import { LinkPicture, describe } from "./link.js";
import { showContact } from "./liveness.js";
import { send } from "./net.js";
import { $, attempt, numberIn, rewrite, state, toast } from "./state.js";
import { element } from "./words.js";

export const picture = new LinkPicture($("link"));

export function showLink() {
  const status = state.link;
  if (!status) return;
  picture.take(status);
  showContact();
  rewrite($("link-summary"), describe(status));
  // Those that were sent, and those that the link doubled ("29+2"), are the sum of the others.
  const head = ["", "sent", "delivered", "in flight", "waiting", "replaced", "lost"];
  const row = (name, c) => [name, c.duplicated ? `${c.offered}+${c.duplicated}` : c.offered, c.delivered, c.in_flight, c.waiting, c.superseded, c.lost + c.dropped_out_of_contact + c.dropped_queue_full];
  const lines = [head, row("up", status.up), row("down", status.down)];
  if (!$("counts").rows.length) {
    const line = (cells, tag) => element("tr", {}, ...cells.map((_, index) => element(index ? tag : "th", {})));
    $("counts").append(...lines.map((cells, index) => line(cells, index ? "td" : "th")));
  }
  lines.forEach((cells, index) => cells.forEach((cell, column) => rewrite($("counts").rows[index].cells[column], String(cell))));
  fillLinkForm();
}

// --- the form -------------------------------------------------------------------------------------------------------
// It shows the conditions as they are, but for the fields that the operator has edited; only those are sent.

const DIRECTIONS = { both: ["up", "down"], up: ["up"], down: ["down"] };
const FIELDS = ["one_way_light_time_s", "loss", "rate_bit_s", "contact"];
const edited = new Map(); // name of a field -> its value on the link when the editing began

// A field's value as text; null if the two directions differ.
function onLink(name) {
  const { conditions, contact_forced: forced } = state.link;
  if (name === "contact") return forced === null ? "schedule" : forced ? "on" : "off";
  const values = DIRECTIONS[$("link-form").elements.direction.value].map((direction) => conditions[direction][name]);
  return values.every((value) => value === values[0]) ? String(values[0] ?? "") : null;
}

function words(name, text) {
  if (text === null) return `${state.link.conditions.up[name] ?? "unlimited"} up, ${state.link.conditions.down[name] ?? "unlimited"} down`;
  return text === "" ? "unlimited" : text;
}

export function fillLinkForm() {
  if (!state.link) return;
  const form = $("link-form").elements, changed = [];
  for (const name of FIELDS) {
    const now = onLink(name), field = form[name];
    if (!edited.has(name)) {
      if (field !== document.activeElement || field.tagName === "SELECT" || field.value === "") field.value = now ?? "";
      if (field.tagName === "INPUT") field.placeholder = words(name, now);
    } else if (edited.get(name) !== now) changed.push(`${field.closest("label").firstChild.textContent.trim().toLowerCase()} is now ${words(name, now)}`);
    field.classList.toggle("edited", edited.has(name));
  }
  $("link-submit").disabled = $("link-reset").disabled = edited.size === 0;
  const note = changed.length ? `Changed meanwhile by another operator: ${changed.join("; ")}` : "";
  if (note === $("link-note").textContent) return;
  rewrite($("link-note"), note);
  look(); // the note may have moved the buttons
}

function forgetEdits() {
  edited.clear();
  if ($("link-form").contains(document.activeElement)) document.activeElement.blur();
  fillLinkForm();
}

function wanted() {
  const form = $("link-form").elements, change = {};
  for (const name of edited.keys()) {
    const field = form[name];
    if (name === "contact") {
      if (field.value === "schedule") change.contact_as_scheduled = true; else change.contact = field.value === "on";
    } else if (name === "rate_bit_s" && field.value === "" && !field.validity.badInput) change.unlimited_rate = true;
    else change[name] = numberIn(field);
  }
  if (form.direction.value !== "both" && Object.keys(change).some((name) => !name.startsWith("contact"))) change.direction = form.direction.value;
  return change;
}

$("link-form").addEventListener("input", (event) => {
  const name = event.target.name;
  if (name === "direction") edited.clear(); // the fields are those of another direction now
  else if (state.link && !edited.has(name)) edited.set(name, onLink(name));
  fillLinkForm();
});
$("link-reset").addEventListener("click", forgetEdits);
$("link-form").addEventListener("keydown", (event) => { if (event.key === "Escape") forgetEdits(); });
$("link-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  if (edited.size === 0) return;
  await attempt(async () => {
    const status = await send("link", wanted());
    state.link = { ...status, at: state.link.at };
    forgetEdits();
    showLink();
    toast("Link changed");
  });
});
