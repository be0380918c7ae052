// A place or a sample that was chosen: what the map says of it.

import { heldAt, map, thresholdPpb, whenThresholdChanges, whenTimeChanges, whenTrackChanges } from "./layers.js";
import { askJson } from "./net.js";
import { tenth } from "./projection.js";
import { fact } from "./rover.js";
import { $, attempt, rewrite, sinceStart, state } from "./state.js";
import { inAddress, keepView, numbers } from "./view.js";
import { elapsed, element, fixed, grouped, utc } from "./words.js";

const HINT = "Click the map, or press Enter at the cross-hair";
const ASK_AGAIN_MS = 300;
let asked = 0;

map.onPlace.push((_, what) => { if (what === "place") showChosen(); });
whenTimeChanges(showPlace);
whenTrackChanges(showSteps);
whenThresholdChanges(showPlace);

function showChosen() {
  $("go-to").disabled = map.chosen === null;
  // On a phone the answer lies over the map, and not over the place that it is of.
  $("answer").classList.toggle("low", map.chosen !== null && map.projection.at(...map.chosen)[1] < map.projection.size[1] / 3);
  showSteps();
  showHeld();
  showPlace();
  keepView();
}

// At once what the map on this page says of the place; the ground's answer takes its place.
function showHeld() {
  delete $("place").dataset.held;
  delete $("place").dataset.point;
  if (!map.chosen) return;
  const [x, y] = map.chosen, held = heldAt(map.chosen);
  if (!held) { // nothing of another place is left
    $("place-hint").textContent = $("answer").textContent = `(${tenth(x)}, ${tenth(y)}) m, asking the ground …`;
    $("place").replaceChildren();
    return;
  }
  const about = held.exact ? "" : "≈ ";
  $("place-hint").textContent = `(${tenth(x)}, ${tenth(y)}) m, revision ${held.revision}, read off this page's map; asking the ground …`;
  $("answer").textContent = `(${tenth(x)}, ${tenth(y)}) m: ${about}${fixed(held.mean_ppb)} ± ${fixed(held.std_ppb)} ppb, read off the map …`;
  $("answer").hidden = false;
  const text = `${about}${fixed(held.mean_ppb)} ± ${fixed(held.std_ppb)} ppb`;
  $("place").replaceChildren(factsOf(text, held, thresholdPpb(), { above: "…", information: "…", ground: "…" }));
  $("place").dataset.held = JSON.stringify(held);
}

// The newest revision of the map: what is shown of an older one is asked for again.
let newest = 0;
export function placeIsAt(revision) {
  newest = revision;
  if (state.past === null) showPlace();
}

async function showPlace() {
  $("answer").hidden = map.chosen === null;
  if (!map.chosen) { $("place").replaceChildren(); $("place-hint").textContent = HINT; return; }
  const [x, y] = map.chosen, mine = ++asked;
  await attempt(async () => {
    const threshold = thresholdPpb();
    const point = await askJson("map/point", { x, y, threshold, as_of: state.past?.revision }).catch((error) => {
      if (mine === asked) for (const id of ["place-hint", "answer"]) rewrite($(id), $(id).textContent.replace("asking the ground …", "the ground did not answer"));
      throw error;
    });
    const sample = map.track?.samples.find((each) => each.sample_id === map.sample), before = sample && await beforeIt(sample);
    if (mine !== asked) return;
    // The ground reports a new map a moment before it answers from it.
    if (state.past === null && point.revision < newest) setTimeout(() => { if (mine === asked) showPlace(); }, ASK_AGAIN_MS);
    $("place-hint").textContent = `${sample ? `Sample ${sample.sample_id} at ` : ""}(${tenth(x)}, ${tenth(y)}) m, revision ${point.revision}`;
    // Where the panel is below the map, the answer is on it as well.
    $("answer").textContent = `(${tenth(x)}, ${tenth(y)}) m: ${fixed(point.mean_ppb)} ± ${fixed(point.std_ppb)} ppb${sample ? `; measured ${fixed(sample.helium3_ppb)} ± ${fixed(sample.noise_std_ppb)} ppb` : ""}${point.traversable ? "" : ", closed"}`;
    delete $("place").dataset.held;
    $("place").dataset.point = JSON.stringify(point);
    $("place").replaceChildren(...(sample ? [ofSample(sample, point, before)] : []), ofPlace(point, threshold));
  });
}

function ofPlace(point, threshold) {
  return factsOf(`${fixed(point.mean_ppb, 3)} ± ${fixed(point.std_ppb, 3)} ppb`, point, threshold, {
    above: `${(100 * point.exceedance).toFixed(1)} %`, information: `${fixed(point.information_nats, 2)} nat`,
    ground: point.traversable ? "traversable" : "not traversable",
  });
}

function factsOf(text, { low_95_ppb, high_95_ppb }, threshold, { above, information, ground }) {
  const [low, high] = [low_95_ppb, high_95_ppb].map((end) => Number.isFinite(end) ? fixed(Math.max(0, end)) : "…"); // the page has no shape
  return element("dl", { class: "facts" }, ...[
    ["Helium-3", text, true], ["95.4 % interval", `${low} to ${high} ppb`], [`More than ${threshold} ppb`, above],
    ["Information of one sample", information], ["Ground", ground],
  ].map(fact));
}

// --- samples --------------------------------------------------------------------------------------------------------

// What the map said at the place of a sample before it knew it; null if no such map is held.
async function beforeIt(sample) {
  const index = map.track.samples.indexOf(sample);
  const held = state.revisions.findLast((each) => each.samples <= index);
  return held ? askJson("map/point", { x: sample.x_m, y: sample.y_m, as_of: held.revision }).catch(() => null) : null;
}

function ofSample(sample, point, before) {
  const { helium3_ppb: value, noise_std_ppb: noise, measured_at: at } = sample;
  const signed = (ppb) => `${ppb < 0 ? "−" : "+"}${fixed(Math.abs(ppb), 3)}`;
  const residual = value - point.mean_ppb, facts = [
    ["Measured", `${fixed(value, 3)} ± ${fixed(noise, 3)} ppb`, true],
    ["Residual against this map", `${signed(residual)} ppb, ${signed(residual / noise)} of its noise`],
  ];
  if (before) {
    const off = value - before.mean_ppb, expected = Math.hypot(before.std_ppb, noise);
    facts.push([`Against revision ${before.revision}, before it`, `${signed(off)} ppb, ${signed(off / expected)} σ`]);
  }
  facts.push(["Depth", `${fixed(sample.depth_m)} m`], ["Time", `${elapsed(sinceStart(at))}`], ["UTC", utc(at)], ["Round", `${sample.round}`]);
  if (Number.isFinite(sample.driven_m)) facts.push(["Driven until then", `${grouped(sample.driven_m)} m`]);
  return element("dl", { class: "facts of-sample", id: "sample-facts" }, ...facts.map(fact));
}

function showSteps() {
  const { samples = [] } = map.track ?? {};
  for (const id of ["sample-before", "sample-after"]) $(id).disabled = samples.length === 0;
}

// The next sample, or the one before it, in the order of arrival; the map follows.
function step(by) {
  const { samples = [] } = map.track ?? {};
  if (!samples.length) return;
  const index = samples.findIndex((each) => each.sample_id === map.sample);
  select(samples[index < 0 ? (by > 0 ? 0 : samples.length - 1) : (index + by + samples.length) % samples.length]);
}

function select({ sample_id, x_m, y_m }) {
  map.sample = sample_id;
  map.chosen = [x_m, y_m];
  if (!map.isWhole()) { map.projection.reveal(x_m, y_m); map.seen(); }
  showChosen();
  map.draw();
}

$("sample-before").addEventListener("click", () => step(-1));
$("sample-after").addEventListener("click", () => step(1));
$("map").addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === "n" || event.key === "N") step(1);
  if (event.key === "p" || event.key === "P") step(-1);
});

inAddress("at", () => map.chosen?.join(","), (text) => {
  const place = numbers(text, 2);
  const on = place && place[0] >= 0 && place[1] >= 0 && place[0] <= map.width && place[1] <= map.height;
  map.chosen = on ? place : null;
  map.sample = null;
  showChosen();
  map.draw();
});
let wantedSample = null; // it is known once the samples are
inAddress("sample", () => map.sample, (text) => { wantedSample = text; takeWanted(); });
whenTrackChanges(takeWanted);
function takeWanted() {
  if (wantedSample === null || !map.track) return;
  const found = map.track.samples.find((each) => each.sample_id === wantedSample);
  wantedSample = null;
  if (found) select(found);
}
