// Measuring: the length along a line that is clicked on the map, or set with the cross-hair.

import { map } from "./layers.js";
import { $ } from "./state.js";
import { inAddress, keepView, pairs } from "./view.js";
import { grouped } from "./words.js";

function setMeasuring(on) {
  if (on && map.drawing) $("draw").click();
  map.measuring = on;
  $("measure").setAttribute("aria-pressed", String(on));
  $("measure").textContent = on ? "Done" : "Measure";
  if (!on) map.legs = [];
  show();
  if (on) $("map").focus({ preventScroll: true });
}

function show() {
  const { legs } = map, lengths = legs.slice(1).map(([x, y], index) => Math.hypot(x - legs[index][0], y - legs[index][1]));
  const sum = lengths.reduce((whole, length) => whole + length, 0);
  $("measure-undo").hidden = legs.length === 0;
  $("measured").textContent = !map.measuring ? "" : legs.length === 0 ? "Click where the line begins" : lengths.length === 0 ? "Click where it goes" : text(lengths, sum, legs);
  map.draw();
  keepView();
}

function text(lengths, sum, legs) {
  const [[ax, ay], [bx, by]] = legs.slice(-2), bearing = (Math.atan2(bx - ax, by - ay) * 180 / Math.PI + 360) % 360;
  const last = `${grouped(lengths.at(-1), 1)} m towards ${Math.round(bearing)}°`;
  return lengths.length === 1 ? last : `${grouped(sum, 1)} m along ${lengths.length} legs, the last ${last}`;
}

function undo() { map.legs.pop(); show(); }

map.onPlace.push((_, what) => { if (what === "leg") show(); });
$("measure").addEventListener("click", () => setMeasuring(!map.measuring));
$("measure-undo").addEventListener("click", undo);
$("draw").addEventListener("click", () => { if (map.measuring) setMeasuring(false); }); // one at a time
$("map").addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === "m" || event.key === "M") setMeasuring(!map.measuring);
  else if (map.measuring && event.key === "Backspace") undo();
  else if (map.measuring && event.key === "Escape") setMeasuring(false);
});
inAddress("measure", () => map.legs.flat().join(","), (text) => {
  const legs = pairs(text);
  if (legs.length || map.measuring) { setMeasuring(legs.length > 0); map.legs = legs; show(); }
});
