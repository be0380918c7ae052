// What the page knows of the mission, mission time, and messages to the operator.

import { element } from "./words.js";

export const $ = (id) => document.getElementById(id);

export const state = {
  clock: null, received: 0, status: null, rover: null, link: null, commands: new Map(), revisions: [],
  alarms: { current: [], history: [] }, events: [], entries: [], modes: [], contacts: null, proposal: null, preview: null,
  past: null, interests: [], connected: false, liveness: null, heard: 0, pace: "–", recording: null,
  stack: null,
};

// Mission time now [ns]; null before the clock is known.
export function now() {
  if (!state.clock) return null;
  return state.clock.now + (performance.now() - state.received) * 1e6 * state.clock.rate;
}

export function keepClock(clock) {
  state.clock = clock;
  state.received = performance.now();
}

export const sinceStart = (ns) => (ns - (state.clock?.start_ns ?? 0)) / 1e9;

export async function attempt(what) {
  try { await what(); } catch (error) { toast(error.message, true); }
}

export function toast(message, bad = false) {
  const shown = element("div", { class: bad ? "bad" : "" }, message);
  shown.addEventListener("click", () => shown.remove()); // it may cover something; the click goes no further
  $("toast").append(shown);
  setTimeout(() => shown.remove(), bad ? 8000 : 4000);
}

// The number in a field. Throws, and puts the keyboard's focus there, if there is none or it is out of range.
export function numberIn(input) {
  const { badInput, rangeUnderflow, rangeOverflow } = input.validity;
  if (!badInput && !rangeUnderflow && !rangeOverflow && input.value !== "") return input.valueAsNumber;
  const name = input.dataset.name ?? input.closest("label").firstChild.textContent.trim().toLowerCase();
  const range = input.min !== "" && input.max !== "" ? ` from ${input.min} to ${input.max}` : input.min !== "" ? ` of ${input.min} or more` : "";
  input.focus();
  throw new Error(`${name}: expected a number${range}, got ${input.value === "" ? (badInput ? "something else" : "nothing") : input.value}`);
}

// Writes only what is different: a click or the keyboard's focus outlives a new text.
export function rewrite(target, text) { if (target.textContent !== text) target.textContent = text; }
