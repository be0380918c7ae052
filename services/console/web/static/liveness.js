// Whether what the page shows is still true: the server's word on the mission, and whether the server is heard at all.

import { $, rewrite, sinceStart, state } from "./state.js";
import { duration, elapsed } from "./words.js";

const DISCONNECTED = { condition: "disconnected", text: "page disconnected; reconnecting …" };
const SILENT_MS = 3000; // three beats of the server
const LOOKS = { live: "good", over: "", ended: "", "out of contact": "warn", "rover overdue": "warn" };
// What is no longer known under each condition; everything where nothing is heard.
const UNKNOWN = { "link silent": ["link"], "ground silent": ["ground"], "out of contact": ["rover"], "rover overdue": ["rover"] };
const ALL = ["link", "ground", "rover"], NOTHING_HEARD = ["disconnected", "mission silent"];

export const isTimeKnown = () => !["disconnected", "mission silent", "link silent", "ended"].includes(document.body.dataset.liveness);

export const isGroundSilent = (liveness) => ["mission silent", "ground silent", "ended"].includes(liveness?.condition);

export function heard(liveness) {
  state.liveness = liveness;
  state.heard = performance.now();
  state.connected = true;
  showLiveness();
}

export function showLiveness() {
  if (!state.liveness) return;
  const silent = !state.connected || performance.now() - state.heard > SILENT_MS;
  const { condition, text } = silent ? DISCONNECTED : state.liveness;
  const unknown = NOTHING_HEARD.includes(condition) ? ALL : UNKNOWN[condition] ?? [];
  document.body.dataset.liveness = condition;
  rewrite($("liveness"), text);
  $("liveness").className = `chip ${LOOKS[condition] ?? "bad"}`;
  for (const card of document.querySelectorAll("[data-known-by]")) {
    const old = unknown.includes(card.dataset.knownBy), made_at = lastHeard(card.dataset.knownBy);
    card.classList.toggle("old", old);
    const note = card.querySelector(".as-of");
    if (note) rewrite(note, old && made_at ? `as of ${elapsed(sinceStart(made_at))}${age(made_at)}` : "");
  }
  showContact();
}

export function showContact() {
  const known = isTimeKnown() && state.link; // both are the link's word
  rewrite($("contact"), !known ? "contact not known" : state.link.contact ? "in contact" : "NO CONTACT");
  $("contact").className = `chip ${!known ? "" : state.link.contact ? "good" : "bad"}`;
}

const lastHeard = (who) => ({ link: state.link?.at, ground: state.status?.at, rover: state.rover?.made_at })[who];

// The age is told only while mission time is known.
function age(made_at) {
  if (!isTimeKnown() || !state.clock) return "";
  const now = state.clock.now + (performance.now() - state.received) * 1e6 * state.clock.rate;
  return `, ${duration(Math.max(0, (now - made_at) / 1e9))} ago`;
}

setInterval(showLiveness, 500);
