// The moment that is pointed at, and the span of time that is seen: one each for the timeline, the plots and the map.
// Both are events on the document, "he3:cursor" with { at_s } and "he3:span" with { span }, in seconds since the mission's
// beginning; null stands for no moment, and for the whole mission.

export const pointAt = (at_s, from) => document.dispatchEvent(new CustomEvent("he3:cursor", { detail: { at_s, from } }));
export const whenPointedAt = (callback) => document.addEventListener("he3:cursor", ({ detail }) => callback(detail.at_s, detail.from));
export const seeSpan = (span) => document.dispatchEvent(new CustomEvent("he3:span", { detail: { span } }));
export const whenSpanSeen = (callback) => document.addEventListener("he3:span", ({ detail }) => callback(detail.span));

const HOUR = 3600, DAY = 86400;
export const STEPS_S = [60, 300, 900, 1800, HOUR, 2 * HOUR, 3 * HOUR, 6 * HOUR, 12 * HOUR, DAY, 2 * DAY, 5 * DAY, 10 * DAY, 20 * DAY, 50 * DAY];

// The time since the beginning as a label of an axis whose labels stand step_s apart.
export function timeLabel(at_s, step_s) {
  if (step_s < HOUR) return `${Math.floor(at_s / HOUR)}:${String(Math.round((at_s % HOUR) / 60)).padStart(2, "0")}`;
  if (step_s < DAY) return `${Math.round(at_s / HOUR)} h`;
  return `${Math.round(at_s / DAY)} d`;
}

const themed = [];
const colours = new Map(); // of the present theme

// A colour of the page's theme, for a canvas.
export function colour(name) {
  if (!colours.has(name)) colours.set(name, getComputedStyle(document.documentElement).getPropertyValue(name).trim());
  return colours.get(name);
}

// Called when the theme has changed: what was drawn on a canvas has the old colours.
export const whenThemeChanges = (callback) => themed.push(callback);
function changeTheme() {
  colours.clear();
  for (const callback of themed) callback();
}
new MutationObserver(changeTheme).observe(document.documentElement, { attributeFilter: ["data-theme"] });
matchMedia("(prefers-color-scheme: light)").addEventListener("change", changeTheme);
