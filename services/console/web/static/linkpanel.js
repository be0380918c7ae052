// The link's panel: messages in flight, counts, and the form that changes the conditions.

import { LinkPicture, describe } from "./link.js";
import { send } from "./net.js";
import { $, attempt, state, toast } from "./state.js";
import { element } from "./words.js";

export const picture = new LinkPicture($("link"));

export function showLink() {
  const status = state.link;
  if (!status) return;
  picture.take(status);
  $("contact").textContent = status.contact ? "in contact" : "NO CONTACT";
  $("contact").className = `chip ${status.contact ? "good" : "bad"}`;
  $("link-summary").textContent = describe(status);
  const head = ["", "sent", "delivered", "in flight", "waiting", "lost"];
  const row = (name, c) => [name, c.offered, c.delivered, c.in_flight, c.waiting, c.lost + c.dropped_out_of_contact + c.dropped_queue_full];
  const line = (cells, tag) => element("tr", {}, ...cells.map((cell, index) => element(index ? tag : "th", {}, String(cell))));
  $("counts").replaceChildren(line(head, "th"), line(row("up", status.up), "td"), line(row("down", status.down), "td"));
}

export function fillLinkForm() {
  const status = state.link, form = $("link-form").elements;
  if (!status || $("link-form").contains(document.activeElement)) return;
  form.one_way_light_time_s.value = status.conditions.down.one_way_light_time_s;
  form.loss.value = status.conditions.down.loss;
  form.rate_bit_s.value = status.conditions.down.rate_bit_s ?? "";
  form.contact.value = status.contact_forced === null ? "schedule" : status.contact_forced ? "on" : "off";
}

$("link-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const form = event.target.elements, change = {};
  if (form.one_way_light_time_s.value !== "") change.one_way_light_time_s = Number(form.one_way_light_time_s.value);
  if (form.loss.value !== "") change.loss = Number(form.loss.value);
  if (form.rate_bit_s.value === "") change.unlimited_rate = true; else change.rate_bit_s = Number(form.rate_bit_s.value);
  if (form.contact.value === "schedule") change.contact_as_scheduled = true; else change.contact = form.contact.value === "on";
  await attempt(async () => { state.link = await send("link", change); showLink(); toast("Link changed"); });
});
