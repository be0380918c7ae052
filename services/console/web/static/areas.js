// Areas: one that is drawn, estimated and sent; and those that are set, which are renamed and removed. A change of the
// list is sent only when the operator says so, and can be undone until then.

import { command } from "./commands.js";
import { look } from "./deliberate.js";
import { describe, map, whenTimeChanges, whenTrackChanges } from "./layers.js";
import { askJson, send } from "./net.js";
import { $, attempt, numberIn, rewrite, state, toast } from "./state.js";
import { inAddress, keepView, pairs } from "./view.js";
import { element, grouped } from "./words.js";

const CONFLICT = 409;
const KINDS = { keepout: "keep-out", interest: "interest" };
const NAME = /^[A-Za-z0-9][A-Za-z0-9_.:-]{0,39}$/;
const NAME_EXPECTED = "name: expected letters, digits and _ . : -, beginning with a letter or digit";

// --- drawing one ----------------------------------------------------------------------------------------------------

function showArea() {
  const corners = map.draft;
  $("undo").disabled = $("clear").disabled = corners.length === 0;
  $("area").hidden = corners.length < 3;
  $("area-hint").textContent = map.drawing ? `${corners.length} corners; click to add one, three at least` : "";
  if (corners.length >= 3) $("area-facts").textContent = `${corners.length} corners, ${grouped(squareMetres(corners))} m²`;
  $("estimate-result").replaceChildren();
  map.draw();
  keepView();
}

function squareMetres(corners) {
  const twice = corners.reduce((sum, [x, y], index) => { const [u, v] = corners[(index + 1) % corners.length]; return sum + x * v - u * y; }, 0);
  return Math.abs(twice) / 2;
}

function setDrawing(on) {
  map.drawing = on;
  $("draw").setAttribute("aria-pressed", String(on));
  $("draw").textContent = on ? "Done" : "Draw area";
  showArea();
  if (on) $("map").focus({ preventScroll: true });
}

map.onPlace.push((_, what) => { if (what === "corner") showArea(); });
$("draw").addEventListener("click", () => setDrawing(!map.drawing));
$("undo").addEventListener("click", () => { map.draft.pop(); showArea(); });
$("clear").addEventListener("click", () => { map.draft = []; showArea(); });
$("map").addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || map.measuring) return;
  if (event.key === "d" || event.key === "D") $("draw").click();
  if (event.key === "Backspace" && map.draft.length) { map.draft.pop(); showArea(); }
  if (event.key === "Escape" && (map.drawing || map.draft.length)) { map.draft = []; setDrawing(false); }
});

$("estimate").addEventListener("click", () => attempt(async () => {
  const cutoff = numberIn($("cutoff"));
  const got = await askJson("map/resource", { polygon: map.draft.flat().join(","), cutoff_ppb: cutoff, as_of: state.past?.revision });
  const between = (interval, digits, scale = 1) => `${grouped(interval.expected * scale, digits)} (${grouped(interval.low * scale, digits)} to ${grouped(interval.high * scale, digits)})`;
  const percent = `${Math.round(got.probability * 100)} %`;
  const rows = [
    ["Helium-3 a metre deep", `${between(got.mass_kg_per_m, 2, 1000)} g/m`],
    ["Mean abundance", `${between(got.mean_ppb, 3)} ppb`],
    [`Area above ${cutoff} ppb`, `${between(got.area_above_m2, 0)} m²`],
    [`Area above it with ${percent} probability`, `${grouped(got.confident_area_m2)} m²`],
  ];
  $("estimate-result").replaceChildren(
    element("table", { class: "result num" }, ...rows.map(([name, value]) => element("tr", {}, element("td", {}, name), element("td", {}, value)))),
    element("p", { class: "dim" }, `${percent} intervals of the joint posterior; bulk density ${grouped(got.bulk_density_kg_m3)} kg/m³; map revision ${got.revision}`),
    element("p", { class: "outdated", role: "status" }),
  );
  estimated = { revision: got.revision, cutoff };
  showWhetherOutdated();
}));

let estimated = null, newest = 0; // what the shown estimate is of, and the newest revision of the map
function showWhetherOutdated() {
  const note = $("estimate-result").querySelector(".outdated");
  if (!note || !estimated) return;
  const shown = state.past?.revision ?? newest;
  const why = shown > estimated.revision ? `of revision ${estimated.revision}; the map is at ${shown}` : shown < estimated.revision && state.past ? `of a later map than the one shown` : "";
  const other = Number($("cutoff").value) === estimated.cutoff ? "" : `for a cut-off of ${estimated.cutoff} ppb`;
  note.textContent = why || other ? `Outdated: ${[why, other].filter(Boolean).join(", ")}. Estimate again.` : "";
  $("estimate-result").classList.toggle("old", note.textContent !== "");
}
$("cutoff").addEventListener("input", showWhetherOutdated);
whenTimeChanges(showWhetherOutdated);
export function estimateIsAt(revision) { newest = revision; showWhetherOutdated(); }

// A name that is in use takes a second, deliberate click: the button says that it replaces that area.
function sends(id, deliver) {
  const button = $(id), label = button.textContent;
  let replaced = null; // the name that the next click replaces
  const say = (text) => { rewrite(button, text); look(); };
  const reset = () => { replaced = null; say(label); };
  $("area-name").addEventListener("input", reset);
  button.addEventListener("click", () => attempt(async () => {
    const name = $("area-name");
    if (!name.reportValidity() || name.value === "") throw new Error(NAME_EXPECTED);
    const area = { area_id: name.value, polygon_m: map.draft, replace: replaced === name.value };
    try {
      if (await deliver(area) === false) return;
    } catch (error) {
      if (error.status === CONFLICT) { replaced = area.area_id; say(`Replace ${area.area_id}`); }
      throw error;
    }
    reset();
    map.draft = [];
    setDrawing(false);
    suggestName();
  }));
}
const sendKeepOut = (area) => command({ kind: "set_keep_out", ...area });
const sendInterest = async (area) => takeInterests(await send("interest", area));
sends("send-keepout", sendKeepOut);
sends("send-interest", async (area) => {
  await sendInterest({ ...area, weight: numberIn($("weight")) });
  toast("Area of interest set");
});

// The next free name of the form area-N, unless the operator has written another.
function suggestName() {
  const used = new Set(listed.map(({ name }) => name));
  if (!/^area-\d+$/.test($("area-name").value)) return;
  let number = 1;
  while (used.has(`area-${number}`)) number += 1;
  $("area-name").value = `area-${number}`;
}

// --- those that are set ---------------------------------------------------------------------------------------------

let listed = [];     // { key, kind, name, corners, weight, on }: on: whether it is on its way, or being removed
let selected = null; // key of the area that is shown on the map
const changes = [];  // { key, to }: not sent; `to` is the new name, or null for a removal
const keyOf = (kind, name) => `${kind}:${name}`;

export function takeInterests({ areas }) { state.interests = areas; showAreas(); }
whenTrackChanges(showAreas);

const same = (corners, others) => JSON.stringify(corners) === JSON.stringify(others ?? null);

export function showAreas() {
  const keepOuts = new Map();
  for (const { area_id, polygon_m } of map.track?.keep_outs ?? []) keepOuts.set(area_id, { corners: polygon_m, on: "", map: true });
  // The ground's map is a moment behind the commands.
  if (state.past === null) for (const { command: sent, end } of state.commands.values()) {
    if (sent.kind !== "set_keep_out") continue;
    const known = keepOuts.get(sent.area_id);
    if (end && end !== "completed") {
      if (known?.map && same(known.corners, sent.polygon_m)) known.on = "not confirmed by the rover";
    } else if (sent.polygon_m) keepOuts.set(sent.area_id, { corners: sent.polygon_m, on: end ? "" : "on its way to the rover" });
    else if (end) keepOuts.delete(sent.area_id);
    else if (known) known.on = "being removed";
  }
  listed = [
    ...[...keepOuts].map(([name, area]) => ({ key: keyOf("keepout", name), kind: "keepout", name, ...area })),
    ...(state.past === null ? state.interests : map.track?.interests ?? []).map(({ area_id: name, polygon_m: corners, weight }) => ({ key: keyOf("interest", name), kind: "interest", name, corners, weight, on: "" })),
  ];
  if (map.draft.length < 3) suggestName();
  map.areas = listed.map(({ key, kind, name, corners, weight }) => ({ kind, corners, name, note: weight === undefined ? "" : ` ×${weight}`, selected: key === selected }));
  map.draw();
  describe();
  drawList();
}

// Rows that are the same stay the same elements: nothing changes under the pointer, or while a name is being written.
const rows = new Map(); // key -> { said, item }
function drawList() {
  const list = $("areas"), focused = document.activeElement, held = list.contains(focused) && { key: focused.closest("li").dataset.key, act: focused.dataset.act };
  const wanted = listed.map(rowOf);
  if (!wanted.length) wanted.push(NONE);
  wanted.forEach((item, index) => { if (list.children[index] !== item) list.insertBefore(item, list.children[index] ?? null); });
  while (list.children.length > wanted.length) list.lastChild.remove();
  $("area-changes").hidden = changes.length === 0;
  $("area-changes-note").textContent = changes.length ? `${changes.length === 1 ? "1 change is" : `${changes.length} changes are`} not sent` : "";
  look();
  if (held && !focused.isConnected && !renaming) focusOn(held);
}

// The keyboard stays where it was in the list, as far as that is still there; else it goes to what can be done next.
function focusOn({ key, act }) {
  const row = [...$("areas").children].find((each) => each.dataset.key === key);
  const control = row?.querySelector(`[data-act="${act}"]`) ?? (changes.length ? $("undo-area") : row?.querySelector("[data-act=show]"));
  control?.focus({ preventScroll: true });
}

const NONE = element("li", { class: "dim" }, "No keep-out and no area of interest is set");
let renaming = null; // key of the area whose new name is being written

function rowOf(area) {
  const change = changes.find(({ key }) => key === area.key), known = rows.get(area.key);
  const said = JSON.stringify([area, change, selected === area.key, renaming === area.key]);
  if (known?.said === said) return known.item;
  const item = row(area, change);
  rows.set(area.key, { said, item });
  return item;
}

function row(area, change) {
  const name = element("button", { type: "button", class: "ghost", title: `${area.name}: show on the map` }, area.name);
  name.dataset.act = "show";
  name.setAttribute("aria-pressed", String(area.key === selected));
  name.addEventListener("click", () => select(area));
  const about = `${KINDS[area.kind]}${area.weight === undefined ? "" : ` ×${area.weight}`} · ${grouped(squareMetres(area.corners))} m²${area.on ? ` · ${area.on}` : ""}`;
  const said = !change ? "" : change.to === null ? "removal not sent" : `→ ${change.to}, not sent`;
  const item = element("li", { class: `${area.kind}${change ? " changed" : ""}` }, name, element("span", { class: "dim num" }, about), element("span", { class: "grow" }), ...(said ? [element("b", {}, said)] : actions(area)));
  item.dataset.key = area.key;
  return item;
}

function actions(area) {
  const under = (...made) => [element("span", { class: "commanders row-actions" }, ...made)];
  if (renaming === area.key) {
    const field = element("input", { type: "text", value: area.name, maxLength: 40 });
    field.dataset.act = "rename"; // where the keyboard goes when the name is left as it was
    field.setAttribute("aria-label", `New name of ${area.name}`);
    const keep = element("button", { type: "button" }, "Rename"), leave = () => { renaming = null; drawList(); };
    const take = () => attempt(async () => { rename(area, field.value.trim()); });
    keep.dataset.act = "rename";
    keep.addEventListener("click", take);
    field.addEventListener("keydown", (event) => {
      if (event.key === "Enter") take();
      else if (event.key === "Escape") leave();
      else return;
      event.preventDefault(); // the key is not for the control that has the focus now
    });
    requestAnimationFrame(() => { field.focus(); field.select(); });
    const cancel = element("button", { type: "button", class: "ghost" }, "Cancel");
    cancel.dataset.act = "rename";
    cancel.addEventListener("click", leave);
    return under(field, keep, cancel);
  }
  const begin = element("button", { type: "button", class: "ghost" }, "Rename"), remove = element("button", { type: "button", class: "ghost" }, "Remove");
  begin.dataset.act = "rename";
  remove.dataset.act = "remove";
  begin.setAttribute("aria-label", `Rename ${area.name}`);
  remove.setAttribute("aria-label", `Remove ${area.name}`);
  begin.addEventListener("click", () => { renaming = area.key; drawList(); });
  remove.addEventListener("click", () => { changes.push({ key: area.key, to: null }); drawList(); });
  return under(begin, remove);
}

function rename(area, to) {
  if (!NAME.test(to)) throw new Error(`${NAME_EXPECTED}, got ${to === "" ? "nothing" : to}`);
  if (to !== area.name) {
    if (listed.some(({ key }) => key === keyOf(area.kind, to)) || changes.some((each) => each.to === to && each.key.startsWith(area.kind))) {
      throw new Error(`name: expected a new one, got that of an area that is set: ${to}`);
    }
    changes.push({ key: area.key, to });
  }
  renaming = null;
  drawList();
}

function select(area) {
  selected = selected === area.key ? null : area.key;
  if (selected) map.frame(area.corners);
  showAreas();
  keepView();
}

$("undo-area").addEventListener("click", () => { changes.pop(); drawList(); });
$("send-areas").addEventListener("click", () => attempt(async () => {
  while (changes.length) {
    const change = changes[0], area = listed.find(({ key }) => key === change.key);
    if (area && await deliver(area, change) === false) return;
    changes.splice(changes.indexOf(change), 1);
    showAreas();
  }
}));

// Sends one change; false if the operator does not send it. The new name comes first: no area is open in between.
async function deliver({ kind, name, corners, weight }, change) {
  const set = kind === "keepout" ? sendKeepOut : (area) => sendInterest({ weight, ...area });
  if (change.to !== null) {
    if (await set({ area_id: change.to, polygon_m: corners }) === false) return false;
    change.to = null; // from here on the old name alone is to go
    drawList();
  }
  return set({ area_id: name });
}

addEventListener("beforeunload", (event) => { if (changes.length) event.preventDefault(); }); // the browser asks first

inAddress("area", () => selected, (text) => { selected = text; showAreas(); });
inAddress("draw", () => map.draft.flat().join(","), (text) => {
  const corners = pairs(text);
  if (!corners.length && !map.draft.length) return;
  map.draft = corners;
  showArea();
});
