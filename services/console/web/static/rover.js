// The rover's panel: its last known state, and how old that is.

import { map } from "./layers.js";
import { $, rewrite, state } from "./state.js";
import { duration, element, fixed, grouped } from "./words.js";

const LOW_ENERGY = .25;

export function showRover() {
  const rover = state.rover;
  if (!rover) return;
  $("rover-mode").textContent = rover.mode;
  $("rover-mode").className = `chip ${rover.mode === "safe" ? "bad" : ["paused", "charging"].includes(rover.mode) ? "warn" : "good"}`;
  const facts = [
    ["Position", `${fixed(rover.x_m, 1)}, ${fixed(rover.y_m, 1)} m`], ["Heading", `${fixed(rover.heading_deg, 0)}°`],
    ["Driven", `${grouped(rover.driven_m)} m`], ["Drilled", `${fixed(rover.drilled_m, 1)} m`],
    ["Round", `${rover.round}`], ["Queued on board", counted(rover.rounds_on_board, "round")],
    ["Not acknowledged", counted(rover.queue_depth, "message")],
  ];
  $("rover-facts").replaceChildren(...facts.map(fact));
  const share = rover.energy_wh / rover.capacity_wh;
  $("energy").textContent = `${grouped(rover.energy_wh)} of ${grouped(rover.capacity_wh)} Wh`;
  $("energy-bar").style.width = `${100 * share}%`;
  $("energy-bar").className = share < LOW_ENERGY ? "low" : "";
  placeRover();
}

export function placeRover() {
  const stale = state.alarms.current.some((alarm) => alarm.kind === "stale" && alarm.active);
  map.rover = state.rover && state.past === null ? { ...state.rover, stale } : null;
  map.draw();
}

export function showAge(time) {
  if (!state.rover) return;
  const light = state.link?.conditions.down.one_way_light_time_s ?? 0;
  const age = Math.max(0, (time - state.rover.made_at) / 1e9);
  rewrite($("rover-age"), `state ${duration(age)} old · light time ${duration(light)}`);
}

export const fact = ([name, value, big]) => element("div", { class: big ? "big" : "" }, element("dt", {}, name), element("dd", {}, value));
const counted = (count, noun) => `${count} ${noun}${count === 1 ? "" : "s"}`;
