// The view is in the page's address: a reload, or another browser, shows the same. Each part of the page says what of it
// belongs there.

import { state } from "./state.js";

const WRITTEN_AFTER_MS = 400; // browsers limit how often the address may change
const parts = [];
let wanted = new URLSearchParams(location.hash.slice(1)); // what the address asks for; null once it is shown
let due = null;

// get: the text in the address, or null for what need not be said. set: called with such a text, or null for its absence;
// what it cannot read, or what does not exist, it leaves out.
export function inAddress(name, get, set) { parts.push({ name, get, set }); }

// The view has changed: the address follows.
export function keepView() {
  if (wanted) return;
  due ??= setTimeout(write, WRITTEN_AFTER_MS);
}

function write() {
  due = null;
  if (wanted) return;
  const view = new URLSearchParams();
  for (const { name, get } of parts) {
    const text = get();
    if (text !== null && text !== undefined && text !== "") view.set(name, text);
  }
  history.replaceState(null, "", view.size ? `#${view.toString().replaceAll("%2C", ",").replaceAll("%3A", ":")}` : location.pathname);
}

// Shows what the address asks for, as soon as there is a map.
export function showView() {
  if (!wanted || !state.revisions.length) return;
  const view = wanted;
  for (const { name, set } of parts) set(view.get(name));
  wanted = null;
  write();
}

addEventListener("hashchange", () => { wanted = new URLSearchParams(location.hash.slice(1)); showView(); });

export const numbers = (text, count) => {
  const found = (text ?? "").split(",").map(Number);
  return text && found.every(Number.isFinite) && (count === undefined || found.length === count) ? found : null;
};
export const pairs = (text) => {
  const found = numbers(text);
  return found && found.length % 2 === 0 ? found.flatMap((_, index) => (index % 2 ? [] : [[found[index], found[index + 1]]])) : [];
};
