// A place that was clicked, and an area that is drawn: what the map says of them, and what is sent about them.

import { command } from "./commands.js";
import { look } from "./deliberate.js";
import { map, whenTimeChanges } from "./layers.js";
import { askJson, send } from "./net.js";
import { fact } from "./rover.js";
import { $, attempt, numberIn, rewrite, state, toast } from "./state.js";
import { element, fixed, grouped } from "./words.js";

const HINT = "Click the map, or press Enter at the cross-hair";
const ASK_AGAIN_MS = 300;
let asked = 0;

map.onPlace = async (place, drawing) => {
  if (drawing) return showArea();
  $("go-to").disabled = false;
  await showPlace();
};
whenTimeChanges(() => { showPlace(); showWhetherOutdated(); });
$("threshold").addEventListener("change", showPlace);

// The newest revision of the map: what is shown of an older one is asked for again, or says that it is outdated.
let newest = 0;
export function mapIsAt(revision) {
  if (revision === newest) return;
  newest = revision;
  if (state.past === null) { showPlace(); showWhetherOutdated(); }
}

async function showPlace() {
  if (!map.chosen) return;
  const [x, y] = map.chosen, mine = ++asked;
  await attempt(async () => {
    const threshold = numberIn($("threshold"));
    const point = await askJson("map/point", { x, y, threshold, as_of: state.past?.revision });
    if (mine !== asked) return;
    // The ground reports a new map a moment before it answers from it.
    if (state.past === null && point.revision < newest) setTimeout(() => { if (mine === asked) showPlace(); }, ASK_AGAIN_MS);
    $("place-hint").textContent = `(${x}, ${y}) m, revision ${point.revision}`;
    $("place").dataset.point = JSON.stringify(point);
    const [low, high] = [-1.96, 1.96].map((factor) => fixed(Math.max(0, point.mean_ppb + factor * point.std_ppb)));
    $("place").replaceChildren(element("dl", { class: "facts" }, ...[
      ["Helium-3", `${fixed(point.mean_ppb, 3)} ± ${fixed(point.std_ppb, 3)} ppb`, true],
      ["95 % interval", `${low} to ${high} ppb`],
      [`More than ${threshold} ppb`, `${(100 * point.exceedance).toFixed(1)} %`],
      ["Information of one sample", `${fixed(point.information_nats, 2)} nat`],
      ["Ground", point.traversable ? "traversable" : "not traversable"],
    ].map(fact)));
  });
}

// --- an area --------------------------------------------------------------------------------------------------------

function showArea() {
  const corners = map.draft;
  $("undo").disabled = $("clear").disabled = corners.length === 0;
  $("area").hidden = corners.length < 3;
  if (map.drawing) $("place-hint").textContent = `${corners.length} corners; click to add one, three at least`;
  else if (!map.chosen) $("place-hint").textContent = HINT;
  if (corners.length >= 3) {
    let twice = 0;
    corners.forEach(([x, y], index) => { const [u, v] = corners[(index + 1) % corners.length]; twice += x * v - u * y; });
    $("area-facts").textContent = `${corners.length} corners, ${grouped(Math.abs(twice) / 2)} m²`;
  }
  $("estimate-result").replaceChildren();
  map.draw();
}

function setDrawing(on) {
  map.drawing = on;
  $("draw").setAttribute("aria-pressed", String(on));
  $("draw").textContent = on ? "Done" : "Draw area";
  showArea();
  if (on) $("map").focus({ preventScroll: true });
}

$("draw").addEventListener("click", () => setDrawing(!map.drawing));
$("undo").addEventListener("click", () => { map.draft.pop(); showArea(); });
$("clear").addEventListener("click", () => { map.draft = []; showArea(); });
$("map").addEventListener("keydown", (event) => {
  if (event.key === "d" || event.key === "D") setDrawing(!map.drawing);
  if (event.key === "Backspace" && map.draft.length) { map.draft.pop(); showArea(); }
  if (event.key === "Escape") { map.draft = []; setDrawing(false); }
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

let estimated = null; // what the shown estimate is of
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

// A name that is in use takes a second, deliberate click: the button says that it replaces that area.
const CONFLICT = 409;
function sends(id, deliver) {
  const button = $(id), label = button.textContent;
  let replaced = null; // the name that the next click replaces
  const say = (text) => { rewrite(button, text); look(); };
  const reset = () => { replaced = null; say(label); };
  $("area-name").addEventListener("input", reset);
  button.addEventListener("click", () => attempt(async () => {
    const name = $("area-name");
    if (!name.reportValidity() || name.value === "") throw new Error("name: expected letters, digits and _ . : -, beginning with a letter or digit");
    const area = { area_id: name.value, polygon_m: map.draft, replace: replaced === name.value };
    try {
      if (await deliver(area) === false) return;
    } catch (error) {
      if (error.status === CONFLICT) { replaced = area.area_id; say(`Replace ${area.area_id}`); }
      throw error;
    }
    reset();
    areaSent();
  }));
}
sends("send-keepout", (area) => command({ kind: "set_keep_out", ...area }));
sends("send-interest", async (area) => {
  takeInterests(await send("interest", { ...area, weight: numberIn($("weight")) }));
  toast("Area of interest set");
});

function areaSent() {
  map.draft = [];
  setDrawing(false);
  suggestName();
}

// The next free name of the form area-N, unless the operator has written another.
function suggestName() {
  const used = new Set(areaNames);
  if (!/^area-\d+$/.test($("area-name").value)) return;
  let number = 1;
  while (used.has(`area-${number}`)) number += 1;
  $("area-name").value = `area-${number}`;
}
let areaNames = [];

export function takeInterests({ areas }) { state.interests = areas; showAreas(); }

export function showAreas() {
  const keepOuts = new Map();
  for (const { command: sent, end } of state.commands.values()) {
    if (sent.kind !== "set_keep_out" || (end && end !== "completed")) continue;
    if (sent.polygon_m) keepOuts.set(sent.area_id, sent.polygon_m); else keepOuts.delete(sent.area_id);
  }
  areaNames = [...keepOuts.keys(), ...state.interests.map(({ area_id }) => area_id)];
  if (map.draft.length < 3) suggestName();
  map.areas = [
    ...[...keepOuts].map(([name, corners]) => ({ name, corners, kind: "keepout" })),
    ...state.interests.map(({ area_id, polygon_m, weight }) => ({ name: `${area_id} ×${weight}`, corners: polygon_m, kind: "interest" })),
  ];
  map.draw();
}
