// A control sends something only when the operator aimed at it: not the second click of a double click, and not a
// control that has just moved under the pointer or has just appeared there.

import { toast } from "./state.js";

const STILL_MS = 600; // how long a control must have stood still before a click on it counts
const GUARDED = ".command-only button, .control-only button, button.acts-only";
const SHIFT_PX = 2;
const places = new WeakMap(); // control -> where it is on the page, and since when
let settled = 0;

// Notes which controls have moved. Those that the page began with count as having stood still.
export function look(began = false) {
  const now = performance.now();
  let moved = false;
  for (const control of document.querySelectorAll(GUARDED)) {
    const box = control.getBoundingClientRect(), at = [box.left + scrollX, box.top + scrollY, box.width, box.height];
    const known = places.get(control);
    if (known && at.every((value, index) => Math.abs(value - known.at[index]) <= SHIFT_PX)) continue;
    places.set(control, { at, since: began ? -Infinity : now });
    moved ||= !began && box.width > 0;
  }
  if (moved) {
    document.body.dataset.moving = "true";
    clearTimeout(settled);
    settled = setTimeout(() => delete document.body.dataset.moving, STILL_MS);
  }
}

export const movedWithin = (control) => performance.now() - (places.get(control)?.since ?? -Infinity) < STILL_MS;

function drop(event) {
  event.stopImmediatePropagation();
  event.preventDefault();
}

document.addEventListener("click", (event) => {
  const control = event.target.closest?.(GUARDED);
  if (!control || event.detail === 0) return; // the keyboard's focus goes with its control
  look();
  if (event.detail > 1) drop(event);
  else if (movedWithin(control)) {
    drop(event);
    document.body.dataset.dropped = Number(document.body.dataset.dropped ?? 0) + 1;
    toast(`“${control.textContent.trim()}” had just moved under the pointer: nothing was sent`, true);
  }
}, true);

look(true);
const sizes = new ResizeObserver(() => look());
for (const part of document.querySelectorAll("header, #warning, #alarms, main > *, .side > *, #area")) sizes.observe(part);
