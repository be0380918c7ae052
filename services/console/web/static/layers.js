// The map's panel: the chosen layer, its colours, what it is compared with, and the way back through the mission's maps.

import { SiteMap } from "./map.js";
import { askJson, download } from "./net.js";
import { Patience } from "./patience.js";
import { Difference, TileSource } from "./raster.js";
import { $, attempt, numberIn, sinceStart, state, toast } from "./state.js";
import { inAddress, keepView, numbers } from "./view.js";
import { elapsed, element, grouped, words } from "./words.js";

const NAMES = {
  mean: "helium-3", std: "standard deviation", information: "information of one sample", exceedance: "probability of more than",
  traversable: "0 closed, 1 open", elevation: "elevation", slope: "steepest slope", shade: "brightness of the relief",
  reference: "helium-3, simulation only", error: "error of the mean, simulation only",
};
const FIXED = { exceedance: [0, 1], traversable: [0, 1] }; // ends of the colours that no value moves
const OF_REGION = ["elevation", "slope", "shade", "reference"]; // the same at every revision
const HISTORY_EVERY_MS = 1900, TRACK_EVERY_MS = 2000, KEPT_SOURCES = 6, AGAIN_MS = 5000;
const UNAVAILABLE = 503;

export const map = new SiteMap($("map"), showHover);
const colours = await askJson("colours");
const onTimeChange = []; // called when another moment is shown
const sources = new Map(); // key -> source; the last used is the last
let loading = false, wanted = false, shownKey = "", trackKey = "", trackAt = -Infinity, trackDue = null;
let threshold = $("threshold").valueAsNumber; // the last that was valid [ppb]
let range = null; // the ends of the colours that the operator has set

const onThreshold = []; // called when another abundance counts as much
export const whenThresholdChanges = (callback) => onThreshold.push(callback);
export const thresholdPpb = () => threshold;
export const whenTimeChanges = (callback) => onTimeChange.push(callback);

const layerInputs = [...document.querySelectorAll("input[name=layer]")];
export const chosenLayer = () => layerInputs.find((each) => each.checked).value;
const compared = () => $("compare").value; // "", "difference" or "swipe"

// --- loading --------------------------------------------------------------------------------------------------------

export function wantMap() {
  showWhetherAnother();
  if (loading) { wanted = true; return; }
  loading = true;
  loadMap()
    // Before the first map, and while the mission is away, there is nothing to tell.
    .catch((error) => { if (state.connected && state.revisions.length && error.status !== UNAVAILABLE) refuse(error.message); })
    .finally(() => { loading = false; if (wanted) { wanted = false; setTimeout(wantMap, 250); } });
}

// What the ground refuses is told once, and asked for again after a while.
let refused = { key: "", until: 0 };
function refuse(why) {
  const key = JSON.stringify({ ...wish(), revision: null });
  if (key !== refused.key) toast(why, true);
  refused = { key, until: performance.now() + AGAIN_MS };
}
const isRefused = (wished) => performance.now() < refused.until && JSON.stringify({ ...wished, revision: null }) === refused.key;

// What is to be shown, as the controls say.
function wish() {
  const layer = chosenLayer(), mode = compared(), revision = state.past?.revision ?? newestRevision();
  const other = mode === "swipe" ? $("other-layer").value : layer;
  const moment = $("other-moment").value;
  return { layer, mode, other, threshold: [layer, other].includes("exceedance") ? threshold : null, revision, past: state.past !== null, than: moment === "" ? revision : Number(moment), relief: $("relief").checked };
}

async function loadMap() {
  if (!state.revisions.length) return; // then the site is not known, either
  const wished = wish(), key = JSON.stringify(wished);
  const track = loadTrack(wished);
  track.catch(() => {}); // awaited below, unless the layer fails first
  if (key !== shownKey && !isRefused(wished)) {
    const { mode } = wished;
    const first = await opened(wished.layer, wished.threshold, wished.revision);
    const second = mode ? await opened(wished.other, wished.threshold, wished.than) : null;
    const relief = wished.relief ? await opened("shade", null, null) : null;
    await map.loaded([first, second, relief].filter(Boolean));
    // By the time it comes, another may be wanted.
    if (key === JSON.stringify(wish())) {
      // The ground reports a new map a moment before it answers from it.
      const late = [[first, wished.revision], [second, wished.than]].filter(([source, asked]) => source && !OF_REGION.includes(source.layer) && source.about.revision < asked && asked === newestRevision());
      refused = { key: "", until: 0 };
      shownKey = late.length ? "" : key;
      if (late.length) wanted = true;
      for (const [source] of late) sources.delete(source.key);
      show(mode === "difference" ? [pane(new Difference(first, second), "difference")] : [pane(first), ...(second ? [pane(second)] : [])], relief, wished);
      if (!late.length) keepBeside(wished).catch(() => { beside = null; }); // then the ground alone answers
    } else wanted = true;
  }
  await track;
}

// Samples, paths and areas: asked for when they may have changed, and not more often than one can follow.
async function loadTrack({ revision, past }) {
  const { status } = state;
  const key = past ? `past ${revision}` : JSON.stringify([revision, status?.samples, status?.round, status?.phase, status?.detail]);
  const age = performance.now() - trackAt;
  if (key === trackKey && (past || age < 3 * TRACK_EVERY_MS)) return;
  if (!past && !trackKey.startsWith("past") && age < TRACK_EVERY_MS) {
    trackDue ??= setTimeout(() => { trackDue = null; wantMap(); }, TRACK_EVERY_MS - age);
    return;
  }
  trackAt = performance.now();
  map.track = await askJson("map/track", { as_of: past ? revision : null });
  trackKey = key;
  for (const callback of onTrack) callback();
  map.draw();
}
// The mean or the standard deviation, whichever is not shown: a place that is chosen then has an answer at once.
let beside = null;
async function keepBeside({ layer, revision, mode }) {
  const other = { mean: "std", std: "mean" }[layer];
  beside = other && !mode && revision !== null && !document.hidden ? await opened(other, null, revision) : null;
}

// What the page's own map says of a place: { mean_ppb, std_ppb, revision, exact }; null if it does not hold both of one revision.
export function heldAt(place) {
  const shown = map.panes.length === 1 ? map.panes[0].source : null;
  if (!shown || !beside || shown.about.revision !== beside.about.revision) return null;
  const ofMean = [shown, beside].find(({ layer }) => layer === "mean"), ofStd = [shown, beside].find(({ layer }) => layer === "std");
  const mean = ofMean?.valueAt(place), std = ofStd?.valueAt(place);
  return mean && std ? { mean_ppb: mean.value, std_ppb: std.value, revision: shown.about.revision, exact: mean.exact && std.exact } : null;
}

const newestRevision = () => state.status?.map_revision ?? null;
const onTrack = []; // called when samples, paths or areas of the map may be others
export const whenTrackChanges = (callback) => onTrack.push(callback);

async function opened(layer, above, revision) {
  const { site } = map.projection, still = OF_REGION.includes(layer);
  const asked = { layer, threshold: layer === "exceedance" ? above : null, revision: still ? null : revision };
  const key = JSON.stringify([asked, site.rows, site.columns, site.resolution_m]);
  let source = sources.get(key);
  sources.delete(key);
  source ??= await new TileSource(site, asked).begin();
  source.key = key;
  sources.set(key, source);
  for (const old of sources.keys()) { if (sources.size <= KEPT_SOURCES) break; sources.delete(old); }
  return source;
}

// The next map is loaded in any case: another mission may count its revisions from 0.
export function forgetMap() { shownKey = trackKey = ""; trackAt = -Infinity; sources.clear(); patience.forget(); }

// --- colours --------------------------------------------------------------------------------------------------------

function pane(source, colourMap) {
  const { layer, about } = source, most = Math.max(-source.low, source.high);
  const own = colourMap ? [source.low, source.high] : FIXED[layer] ?? (layer === "error" ? [-most, most] : [source.low, source.high]);
  return { source, stops: colours.stops[colourMap ?? colours.of_layer[layer]], own, range: own, about, title: titleOf(source) };
}

// What a source shows, in words.
function titleOf(source) {
  if (source instanceof Difference) return `${words(source.layer)}: revision ${source.now.about.revision} less revision ${source.then.about.revision}`;
  return OF_REGION.includes(source.layer) ? words(source.layer) : `${words(source.layer)} · revision ${source.about.revision}`;
}

// The map is pale while the controls already name another layer, comparison or moment than it shows.
const lookOf = ({ layer, mode, other, threshold, revision, past }) => JSON.stringify([layer, mode, mode && other, threshold, past && revision]);
let shownLook = null;
function showWhetherAnother() {
  if (shownLook !== null) $("map").classList.toggle("another", lookOf(wish()) !== shownLook);
}

function show(panes, relief, wished) {
  shownLook = lookOf(wished);
  showWhetherAnother();
  if (range) panes[0].range = range;
  map.setPanes(panes, relief);
  showScales();
  const { about } = panes[0];
  $("map").dataset.shown = JSON.stringify({ layer: wished.layer, revision: about.revision, samples: about.samples, mode: wished.mode, other: panes[1]?.source.layer ?? null });
  $("swipe").hidden = panes.length < 2;
  placeSwipe();
  describe();
}

function showScales() {
  const { panes } = map;
  if (!panes.length) return;
  showScale($("colours"), $("ticks"), panes[0]);
  $("other-scale").hidden = panes.length < 2;
  if (panes.length > 1) showScale($("other-colours"), $("other-ticks"), panes[1]);
  const [low, high] = panes[0].range.map((end) => Number(end.toPrecision(5)));
  if (document.activeElement !== $("range-low")) $("range-low").value = low;
  if (document.activeElement !== $("range-high")) $("range-high").value = high;
  $("range-auto").disabled = range === null;
}

function showScale(canvas, ticks, shown) {
  ramp(canvas, shown.stops);
  ticks.replaceChildren(...scaleTexts(shown).map((text) => element("span", {}, text)));
}

export function ramp(canvas, stops) {
  const context = canvas.getContext("2d");
  canvas.width = 512;
  const gradient = context.createLinearGradient(0, 0, 512, 0);
  stops.forEach((stop, index) => gradient.addColorStop(index / (stops.length - 1), stop));
  context.fillStyle = gradient;
  context.fillRect(0, 0, 512, canvas.height);
}

// The texts below a scale: at its low end, in the middle, at its high end.
export function scaleTexts({ source, about, range: [low, high], own }) {
  const { layer } = source, isDifference = source instanceof Difference, unit = about.unit === "1" ? "" : ` ${about.unit}`;
  const name = layer === "exceedance" ? `${NAMES[layer]} ${about.threshold_ppb} ppb` : NAMES[layer];
  const middle = isDifference ? `${name}: revision ${source.now.about.revision} less revision ${source.then.about.revision}` : name;
  const whole = Number.isInteger(low) && Number.isInteger(high);
  const digits = !unit && whole ? 0 : high - low < .5 ? 3 : Math.abs(high) >= 1000 ? 1 : 2;
  if (high <= low && unit) return [grouped(low, digits) + unit, `${middle}, the same everywhere`, ""];
  const beyond = [own[0] < low - 1e-9 ? "≤ " : "", own[1] > high + 1e-9 ? "≥ " : ""];
  return [beyond[0] + grouped(low, digits) + unit, middle, beyond[1] + grouped(high, digits) + unit];
}

function setRange(ends) {
  range = ends;
  if (map.panes.length) map.panes[0].range = ends ?? map.panes[0].own;
  showScales();
  map.draw();
  keepView();
}

function readRange() {
  const ends = [$("range-low"), $("range-high")].map((input) => input.valueAsNumber);
  if (!ends.every(Number.isFinite)) return;
  if (ends[0] >= ends[1]) { toast(`colours: expected a range from low to high, got ${ends[0]} to ${ends[1]}`, true); return; }
  setRange(ends);
}
for (const id of ["range-low", "range-high"]) $(id).addEventListener("change", readRange);
$("range-auto").addEventListener("click", () => setRange(null));

// --- the value under the pointer ------------------------------------------------------------------------------------

function showHover(place, at, event, sample) {
  const box = $("hover");
  if (!place) { box.hidden = true; return; }
  box.textContent = valueText(place, map.paneAt(at[0])) + (sample ? `  ·  sample ${sample.sample_id}: ${grouped(sample.helium3_ppb, 3)} ppb` : "") + map.areasAt(place).map(({ kind, name, note }) => `  ·  ${kind === "keepout" ? "keep-out" : "interest"} ${name}${note}`).join("");
  box.hidden = false;
  const wrap = $("map").getBoundingClientRect();
  box.style.left = `${Math.min(at[0] + 14, wrap.width - box.offsetWidth - 4)}px`;
  box.style.top = `${Math.max(4, at[1] - 34)}px`;
  if (event?.type === "keydown") say(box.textContent);
}

function valueText(place, shown) {
  const found = shown?.source.valueAt(place), unit = shown?.about.unit;
  const value = found ? `  ${found.exact ? "" : "≈ "}${grouped(found.value, 3)}${unit === "1" ? "" : ` ${unit}`}` : "";
  return `(${place[0]}, ${place[1]}) m${value}`;
}

// Said by a screen reader, once the operator rests.
const SAID_AFTER_MS = 350;
let saying = null;
function say(text) {
  clearTimeout(saying);
  saying = setTimeout(() => { $("map-says").textContent = text; }, SAID_AFTER_MS);
}
map.onSay = say;

// --- earlier maps ---------------------------------------------------------------------------------------------------

// The list of revisions grows with the map.
let historyAt = 0;
const patience = new Patience(HISTORY_EVERY_MS);
export async function refreshHistory(atOnce = false) {
  const isKnown = state.revisions.length > 0 && state.revisions.at(-1).revision === newestRevision();
  if (!atOnce && (isKnown || performance.now() - historyAt < HISTORY_EVERY_MS || document.hidden || !patience.mayAsk(performance.now()))) return;
  historyAt = performance.now();
  try {
    const { site, revisions } = await askJson("map/history");
    patience.forget();
    map.setSite(site);
    $("provenance").textContent = site.provenance ?? "";
    state.revisions = revisions;
    const slider = $("time");
    slider.max = revisions.length - 1;
    if (state.past === null) slider.value = revisions.length - 1;
    else slider.value = Math.max(0, revisions.findIndex((each) => each.revision === state.past.revision));
    showTime();
    offerMoments();
    if (atOnce) wantMap();
  } catch { patience.failed(performance.now()); } // there is no map yet, or no ground: a later beat asks again
}

// A status tells of another map than those that are known.
export const mapIsPromised = () => patience.forget();

// The ground has been heard again: what it did not answer is asked for at once.
export function groundIsHeard() {
  patience.forget();
  for (const source of sources.values()) source.failed.clear();
  map.draw();
}

function showTime() {
  const shown = state.past ?? state.revisions.at(-1);
  $("live").setAttribute("aria-pressed", String(state.past === null));
  $("past").hidden = state.past === null;
  if (!shown) return;
  const at = elapsed(sinceStart(shown.mission_time_ns));
  $("time-label").textContent = `${state.past ? "" : "now · "}${at} · ${shown.samples} samples`;
  $("time").setAttribute("aria-valuetext", `revision ${shown.revision}, ${at}, ${shown.samples} samples`);
  $("past").textContent = `Map of ${at}`;
}

export function showMoment(revision) {
  state.past = revision;
  $("time").value = revision === null ? $("time").max : state.revisions.indexOf(revision);
  showTime();
  wantMap();
  keepView();
  for (const callback of onTimeChange) callback();
}

$("time").addEventListener("input", (event) => {
  const index = Number(event.target.value);
  showMoment(index >= state.revisions.length - 1 ? null : state.revisions[index]);
});
$("live").addEventListener("click", () => showMoment(null));

// --- comparison -----------------------------------------------------------------------------------------------------

// The moments that a map can be compared with. The list is made anew when it is opened, not under the operator's hand.
function offerMoments(chosen = $("other-moment").value) {
  const select = $("other-moment");
  if (document.activeElement === select) return;
  const known = [...select.options].map((option) => option.value).join(), now = ["", ...state.revisions.map(({ revision }) => String(revision))];
  if (now.join() !== known) {
    select.replaceChildren(element("option", { value: "" }, "the same moment"), ...state.revisions.map(({ revision, samples, mission_time_ns }) => (
      element("option", { value: String(revision) }, `revision ${revision} · ${samples} samples · ${elapsed(sinceStart(mission_time_ns))}`))));
  }
  select.value = now.includes(chosen) ? chosen : "";
}

function showComparison() {
  const mode = compared();
  $("other-layer-field").hidden = mode !== "swipe";
  $("other-moment-field").hidden = mode === "";
  $("threshold-field").hidden = chosenLayer() !== "exceedance" && !(mode === "swipe" && $("other-layer").value === "exceedance");
}

function changed() {
  range = null; // it was for other values
  showComparison();
  wantMap();
  keepView();
}

$("compare").addEventListener("change", () => {
  // A difference from the same moment is 0 everywhere: begin with the first map.
  if (compared() === "difference" && $("other-moment").value === "" && state.revisions.length) offerMoments(String(state.revisions[0].revision));
  changed();
});
for (const id of ["other-layer", "other-moment"]) $(id).addEventListener("change", changed);
for (const input of layerInputs) input.addEventListener("change", changed);
$("relief").addEventListener("change", () => { wantMap(); keepView(); });
$("threshold").addEventListener("change", () => attempt(async () => { threshold = numberIn($("threshold")); changed(); for (const callback of onThreshold) callback(); }));

function placeSwipe() {
  if ($("swipe").hidden || !map.projection.size) return;
  const { left, right, top, bottom } = map.projection.box, swipe = $("swipe");
  swipe.style.left = `${map.splitAt}px`;
  swipe.style.top = `${(top + bottom) / 2}px`;
  const percent = Math.round(100 * map.split);
  swipe.setAttribute("aria-valuenow", percent);
  swipe.setAttribute("aria-valuetext", `${percent} % ${map.panes[0]?.title}, the rest ${map.panes[1]?.title}`);
}
map.onView.push(placeSwipe);

function setSplit(share) {
  map.split = Math.min(1, Math.max(0, share));
  placeSwipe();
  map.draw();
  keepView();
}

$("swipe").addEventListener("pointerdown", (event) => { $("swipe").setPointerCapture(event.pointerId); event.preventDefault(); $("swipe").focus(); });
$("swipe").addEventListener("pointermove", (event) => {
  if (!$("swipe").hasPointerCapture(event.pointerId)) return;
  const { left, right } = map.projection.box;
  setSplit((event.clientX - $("map").getBoundingClientRect().left - left) / (right - left));
});
$("swipe").addEventListener("keydown", (event) => {
  const steps = { ArrowLeft: -.02, ArrowRight: .02, PageDown: -.1, PageUp: .1, Home: -1, End: 1 };
  if (!(event.key in steps)) return;
  setSplit(map.split + steps[event.key]);
  event.preventDefault();
});

// --- other controls -------------------------------------------------------------------------------------------------

$("download").addEventListener("click", async () => {
  $("download").disabled = true;
  try {
    await download("map/export", { as_of: state.past?.revision ?? null, threshold: $("threshold").value });
  } catch (error) { toast(error.message, true); }
  $("download").disabled = false;
});
for (const [id, what] of [["show-paths", "paths"], ["show-samples", "samples"]]) {
  $(id).addEventListener("change", (event) => { map.show[what] = event.target.checked; map.draw(); keepView(); });
}
$("zoom-in").addEventListener("click", () => map.zoomBy(1.5));
$("zoom-out").addEventListener("click", () => map.zoomBy(1 / 1.5));
$("zoom-fit").addEventListener("click", () => map.fit());
map.onView.push(() => {
  $("zoom-out").disabled = $("zoom-fit").disabled = map.isWhole();
  $("zoom-in").disabled = map.projection.size !== null && map.projection.zoom >= map.projection.mostZoom;
  describe();
  keepView();
});

// The map in words, for those who do not see it; read when they ask for it.
const DESCRIBED_AFTER_MS = 300;
let describing = null;
export function describe() { describing ??= setTimeout(() => { describing = null; $("map-text").textContent = inWords(); }, DESCRIBED_AFTER_MS); }

function inWords() {
  if (!map.panes.length || !map.projection.size) return "There is no map yet.";
  const { west, south, east, north } = map.projection.window, about = map.panes.map((shown) => `${shown.title}, ${scaleTexts(shown).filter(Boolean).join(", ")}.`);
  const metres = (value) => grouped(value);
  const parts = [...about, `Seen: ${metres(west)} to ${metres(east)} m east, ${metres(south)} to ${metres(north)} m north.`];
  if (map.track) parts.push(`${map.track.samples.length} samples.`);
  if (map.rover) parts.push(`Rover at (${map.rover.x_m.toFixed(1)}, ${map.rover.y_m.toFixed(1)}) m.`);
  if (map.areas.length) parts.push(`Areas: ${map.areas.map(({ name, note, kind }) => `${name}${note}, ${kind === "keepout" ? "keep-out" : "interest"}`).join("; ")}.`);
  return parts.join(" ");
}

// --- the address ----------------------------------------------------------------------------------------------------

inAddress("layer", () => (chosenLayer() === "mean" ? null : chosenLayer()), (text) => {
  (layerInputs.find((each) => each.value === text) ?? layerInputs[0]).checked = true;
});
inAddress("threshold", () => ($("threshold-field").hidden ? null : $("threshold").value), (text) => {
  if (text === null || !Number.isFinite(Number(text))) return;
  $("threshold").value = text;
  threshold = Number(text);
});
inAddress("revision", () => state.past?.revision, (text) => {
  const past = state.revisions.find((each) => String(each.revision) === text) ?? null;
  if (past !== state.past) showMoment(past);
});
const inSelect = (name, id, get) => inAddress(name, get, (text) => {
  const values = [...$(id).options].map((option) => option.value);
  $(id).value = values.includes(text) ? text : values[0];
});
inSelect("compare", "compare", compared);
inSelect("with", "other-layer", () => (compared() === "swipe" ? $("other-layer").value : null));
inAddress("than", () => (compared() ? $("other-moment").value : null), (text) => offerMoments(text ?? ""));
inAddress("split", () => (compared() === "swipe" && map.split !== .5 ? map.split.toFixed(3) : null), (text) => setSplit(numbers(text, 1)?.[0] ?? .5));
inAddress("relief", () => ($("relief").checked ? "1" : null), (text) => { $("relief").checked = text === "1"; showComparison(); wantMap(); });
inAddress("range", () => range?.map((end) => Number(end.toPrecision(7))).join(","), (text) => {
  const ends = numbers(text, 2);
  setRange(ends && ends[0] < ends[1] ? ends : null);
});
inAddress("hide", () => ["paths", "samples"].filter((what) => !map.show[what]).join(","), (text) => {
  for (const what of ["paths", "samples"]) map.show[what] = $(`show-${what}`).checked = !(text ?? "").split(",").includes(what);
});
inAddress("zoom", () => (map.isWhole() ? null : Number(map.projection.zoom.toPrecision(4))), (text) => {
  map.look(Math.max(1, numbers(text, 1)?.[0] ?? 1), map.projection.centre);
});
inAddress("centre", () => (map.isWhole() ? null : map.projection.middle.map((value) => value.toFixed(1)).join(",")), (text) => {
  map.look(map.projection.zoom, numbers(text, 2));
});
if (compared() || location.hash.includes("compare") || location.hash.includes("relief") || location.hash.includes("range")) $("view-options").open = true;
