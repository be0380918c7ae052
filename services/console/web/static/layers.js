// The map's panel: the chosen layer, its scale, and the timeline back through the mission's maps.

import { SiteMap } from "./map.js";
import { askJson, askLayer, download } from "./net.js";
import { $, numberIn, sinceStart, state, toast } from "./state.js";
import { elapsed, element } from "./words.js";

const NAMES = { mean: "helium-3", std: "standard deviation", information: "information of one sample", exceedance: "probability of more than", traversable: "0 closed, 1 open",
  elevation: "elevation", slope: "steepest slope", shade: "brightness of the relief, light from the north-west", reference: "helium-3, simulation only", error: "error of the mean, simulation only" };
const HISTORY_EVERY_MS = 1900;
const UNAVAILABLE = 503;

export const map = new SiteMap($("map"), showHover);
const colours = await askJson("colours");
const onTimeChange = []; // called when another moment is shown
let loading = false, wanted = false, shownKey = "";

export const whenTimeChanges = (callback) => onTimeChange.push(callback);

const chosenLayer = () => document.querySelector("input[name=layer]:checked").value;

export function wantMap() {
  if (loading) { wanted = true; return; }
  loading = true;
  loadMap()
    // Before the first map, and while the mission is away, there is nothing to tell.
    .catch((error) => { if (state.connected && state.revisions.length && error.status !== UNAVAILABLE) toast(error.message, true); })
    .finally(() => { loading = false; if (wanted) { wanted = false; setTimeout(wantMap, 250); } });
}

async function loadMap() {
  const layer = chosenLayer(), as_of = state.past?.revision ?? null;
  const threshold = layer === "exceedance" ? numberIn($("threshold")) : null;
  const revision = as_of ?? state.status?.map_revision ?? 0;
  const key = `${layer} ${threshold} ${revision}`;
  const track = askJson("map/track", { as_of });
  track.catch(() => {}); // awaited below, unless the layer fails first
  if (key !== shownKey) {
    const got = await askLayer({ layer, threshold, as_of });
    // By the time it comes, another may be wanted.
    if (layer === chosenLayer() && as_of === (state.past?.revision ?? null)) {
      // The ground reports a new map a moment before it answers from it.
      shownKey = got.about.revision >= revision || as_of !== null ? key : "";
      if (!shownKey) wanted = true;
      const range = layer === "exceedance" || layer === "traversable" ? [0, 1] : layer === "error" ? evenly(got.about) : [got.about.low, got.about.high];
      const stops = colours.stops[colours.of_layer[layer]];
      map.setLayer(got, stops, range);
      showScale(layer, stops, range, got.about);
      $("map").dataset.shown = JSON.stringify({ layer, revision: got.about.revision, samples: got.about.samples });
    }
  }
  map.track = await track;
  map.draw();
}

// 0 in the middle.
function evenly({ low, high }) { const most = Math.max(-low, high); return [-most, most]; }

// The next map is loaded in any case: another mission may count its revisions from 0.
export function forgetMap() { shownKey = ""; }

function showScale(layer, stops, [low, high], about) {
  const canvas = $("colours"), context = canvas.getContext("2d");
  canvas.width = 512;
  const gradient = context.createLinearGradient(0, 0, 512, 0);
  stops.forEach((stop, index) => gradient.addColorStop(index / (stops.length - 1), stop));
  context.fillStyle = gradient;
  context.fillRect(0, 0, 512, canvas.height);
  const unit = about.unit === "1" ? "" : ` ${about.unit}`;
  const middle = layer === "exceedance" ? `${NAMES[layer]} ${about.threshold_ppb} ppb` : NAMES[layer];
  const whole = Number.isInteger(low) && Number.isInteger(high);
  const digits = !unit && whole ? 0 : high - low < .5 ? 3 : 2;
  const everywhere = high <= low && unit;
  $("ticks").replaceChildren(
    element("span", {}, low.toFixed(digits) + unit),
    element("span", {}, everywhere ? `${middle}, the same everywhere` : middle),
    element("span", {}, everywhere ? "" : high.toFixed(digits) + unit),
  );
}

function showHover(place, event) {
  const box = $("hover");
  if (!place) { box.hidden = true; return; }
  const value = map.valueAt(place), unit = map.layer?.about.unit ?? "";
  box.textContent = `(${place[0]}, ${place[1]}) m${value === null || value === undefined ? "" : `  ${value.toFixed(3)}${unit === "1" ? "" : " " + unit}`}`;
  box.hidden = false;
  const wrap = $("map").getBoundingClientRect();
  const [x, y] = event ? [event.clientX - wrap.left, event.clientY - wrap.top] : map.at(...place);
  box.style.left = `${Math.min(x + 14, wrap.width - box.offsetWidth - 4)}px`;
  box.style.top = `${Math.max(4, y - 34)}px`;
}

// --- earlier maps ---------------------------------------------------------------------------------------------------

let historyAt = 0;
export async function refreshHistory(atOnce = false) {
  if (!atOnce && (performance.now() - historyAt < HISTORY_EVERY_MS || document.hidden)) return;
  historyAt = performance.now();
  try {
    const { site, revisions } = await askJson("map/history");
    map.setSite(site);
    $("provenance").textContent = site.provenance ?? "";
    state.revisions = revisions;
    const slider = $("time");
    slider.max = revisions.length - 1;
    if (state.past === null) slider.value = revisions.length - 1;
    else slider.value = Math.max(0, revisions.findIndex((each) => each.revision === state.past.revision));
    showTime();
    if (atOnce) wantMap();
  } catch { /* there is no map yet; the next beat asks again */ }
}

function showTime() {
  const shown = state.past ?? state.revisions.at(-1);
  $("live").setAttribute("aria-pressed", String(state.past === null));
  $("past").hidden = state.past === null;
  if (!shown) return;
  const at = elapsed(sinceStart(shown.mission_time_ns));
  $("time-label").textContent = `${state.past ? "" : "now · "}${at} · ${shown.samples} samples`;
  $("past").textContent = `Map of ${at}`;
}

export function showMoment(revision) {
  state.past = revision;
  showTime();
  wantMap();
  for (const callback of onTimeChange) callback();
}

$("time").addEventListener("input", (event) => {
  const index = Number(event.target.value);
  showMoment(index >= state.revisions.length - 1 ? null : state.revisions[index]);
});
$("live").addEventListener("click", () => { $("time").value = $("time").max; showMoment(null); });

for (const input of document.querySelectorAll("input[name=layer]")) input.addEventListener("change", () => {
  $("threshold-field").hidden = chosenLayer() !== "exceedance";
  wantMap();
});
$("threshold").addEventListener("change", wantMap);
$("download").addEventListener("click", async () => {
  $("download").disabled = true;
  try {
    await download("map/export", { as_of: state.past?.revision ?? null, threshold: $("threshold").value });
  } catch (error) { toast(error.message, true); }
  $("download").disabled = false;
});
$("show-paths").addEventListener("change", (event) => { map.show.paths = event.target.checked; map.draw(); });
$("show-samples").addEventListener("change", (event) => { map.show.samples = event.target.checked; map.draw(); });
