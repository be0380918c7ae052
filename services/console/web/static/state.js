// What the page knows of the mission, mission time, and messages to the operator.

import { element } from "./words.js";

export const $ = (id) => document.getElementById(id);

export const state = {
  clock: null, received: 0, status: null, rover: null, link: null, commands: new Map(), alarms: [], revisions: [],
  past: null, interests: [], connected: false,
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
  $("toast").append(shown);
  setTimeout(() => shown.remove(), bad ? 8000 : 4000);
}

// Writes only what is different: a click or the keyboard's focus outlives a new text.
export function rewrite(target, text) { if (target.textContent !== text) target.textContent = text; }
