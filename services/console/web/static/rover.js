// The rover's panel: its last known state, and how old that is.

import { map } from "./layers.js";
import { $, rewrite, state } from "./state.js";
import { duration, element, fixed, grouped } from "./words.js";

const LOW_ENERGY = .25;

export function showRover() {
  const rover = state.rover;
  if (!rover) return;
  rewrite($("rover-mode"), rover.mode);
  $("rover-mode").className = `chip ${rover.mode === "safe" ? "bad" : ["paused", "charging"].includes(rover.mode) ? "warn" : "good"}`;
  const facts = [
    ["Position", `${fixed(rover.x_m, 1)}, ${fixed(rover.y_m, 1)} m`], ["Heading", `${fixed(rover.heading_deg, 0)}°`],
    ["Driven", `${grouped(rover.driven_m)} m`], ["Drilled", `${fixed(rover.drilled_m, 1)} m`],
    ["Round", `${rover.round}`], ["Queued on board", counted(rover.rounds_on_board, "round")],
    ["Not acknowledged", counted(rover.queue_depth, "message")],
  ];
  showFacts($("rover-facts"), facts);
  const share = rover.energy_wh / rover.capacity_wh;
  rewrite($("energy"), `${grouped(rover.energy_wh)} of ${grouped(rover.capacity_wh)} Wh`);
  $("energy-bar").style.width = `${100 * share}%`;
  $("energy-bar").className = share < LOW_ENERGY ? "low" : "";
  placeRover();
}

let placed = ""; // how the rover was drawn last
export function placeRover() {
  const stale = state.alarms.current.some((alarm) => alarm.kind === "stale" && alarm.active);
  map.rover = state.rover && state.past === null ? { ...state.rover, stale } : null;
  const look = map.rover && map.projection.size ? [...map.at(map.rover.x_m, map.rover.y_m), map.rover.heading_deg].map(Math.round).concat(stale).join() : "";
  if (look === placed) return; // it has not moved by a pixel
  placed = look;
  map.draw();
}

export function showAge(time) {
  if (!state.rover) return;
  const light = state.link?.conditions.down.one_way_light_time_s ?? 0;
  const age = Math.max(0, (time - state.rover.made_at) / 1e9);
  rewrite($("rover-age"), `state ${duration(age)} old · light time ${duration(light)}`);
}

// Writes the facts into their list; only what is different, where it has them already.
function showFacts(list, facts) {
  if (list.children.length !== facts.length) list.replaceChildren(...facts.map(fact));
  facts.forEach(([, value], index) => rewrite(list.children[index].lastChild, value));
}

export const fact = ([name, value, big]) => element("div", { class: big ? "big" : "" }, element("dt", {}, name), element("dd", {}, value));
const counted = (count, noun) => `${count} ${noun}${count === 1 ? "" : "s"}`;
