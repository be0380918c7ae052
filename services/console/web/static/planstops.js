// The stops of a plan that is edited: samples to take, in their order. Pure: a list in, another list out.
// A stop is { name, x_m, y_m, taken, added }; the start is where the round begins, [x, y].

import { tenth } from "./projection.js";

export const stopsOf = ({ samples }) => samples.map(({ sample_id, x_m, y_m }) => ({ name: sample_id, x_m, y_m, taken: true, added: false }));
export const placeOf = ({ x_m, y_m }) => [x_m, y_m];
export const taken = (stops) => stops.filter((stop) => stop.taken);

const changed = (stops, index, changes) => stops.map((stop, at) => (at === index ? { ...stop, ...changes } : stop));
export const moved = (stops, index, [x, y]) => changed(stops, index, { x_m: tenth(x), y_m: tenth(y) });
export const ticked = (stops, index, isTaken) => (stops[index].added && !isTaken ? stops.filter((_, at) => at !== index) : changed(stops, index, { taken: isTaken }));

// The stop `by` places earlier or later.
export function shifted(stops, index, by) {
  const to = index + by;
  if (to < 0 || to >= stops.length) return stops;
  const others = stops.filter((_, at) => at !== index);
  return [...others.slice(0, to), stops[index], ...others.slice(to)];
}

// A further stop where it makes the way, straight from stop to stop, the least longer.
export function inserted(stops, start, [x, y]) {
  const added = { name: nextName(stops), x_m: tenth(x), y_m: tenth(y), taken: true, added: true };
  const between = [start, ...stops.map(placeOf)], here = placeOf(added);
  const detours = between.map((from, at) => (at + 1 < between.length ? apart(from, here) + apart(here, between[at + 1]) - apart(from, between[at + 1]) : apart(from, here)));
  const at = detours.indexOf(Math.min(...detours));
  return [...stops.slice(0, at), added, ...stops.slice(at)];
}

const apart = ([ax, ay], [bx, by]) => Math.hypot(ax - bx, ay - by);
const nextName = (stops) => `new ${1 + Math.max(0, ...stops.filter(({ added }) => added).map(({ name }) => Number(name.slice(4))))}`;

// Whether the ground has to find other ways: samples that are only left out do not change them.
export function isRevised(stops, plan) {
  const before = stopsOf(plan);
  return stops.length !== before.length || stops.some((stop, index) => stop.name !== before[index].name || apart(placeOf(stop), placeOf(before[index])) > 0);
}
