// The view is in the page's address: layer, threshold, moment and place. A reload, or another browser, shows the same.

import { map, showMoment, wantMap, whenTimeChanges } from "./layers.js";
import "./place.js"; // sets what follows upon a place
import { $, state } from "./state.js";

let wanted = new URLSearchParams(location.hash.slice(1)); // what the address asks for; null once it is shown

const layers = () => [...document.querySelectorAll("input[name=layer]")];

function keepView() {
  if (wanted) return;
  const view = new URLSearchParams(), layer = layers().find((each) => each.checked).value;
  if (layer !== "mean") view.set("layer", layer);
  if (layer === "exceedance") view.set("threshold", $("threshold").value);
  if (state.past) view.set("revision", state.past.revision);
  if (map.chosen) view.set("at", map.chosen.join(","));
  history.replaceState(null, "", view.size ? `#${view.toString().replaceAll("%2C", ",")}` : location.pathname);
}

// Shows what the address asks for, as soon as there is a map. What it names and there is not is left out.
export function showView() {
  if (!wanted || !state.revisions.length) return;
  const view = wanted;
  wanted = null;
  const layer = layers().find((each) => each.value === view.get("layer"));
  if (view.has("threshold") && Number.isFinite(Number(view.get("threshold")))) $("threshold").value = view.get("threshold");
  if (layer) {
    layer.checked = true;
    $("threshold-field").hidden = layer.value !== "exceedance";
    wantMap();
  }
  const past = state.revisions.find((each) => String(each.revision) === view.get("revision"));
  if (past) {
    $("time").value = state.revisions.indexOf(past);
    showMoment(past);
  }
  const [x, y] = (view.get("at") ?? "").split(",").map(Number);
  if (view.get("at") && x >= 0 && y >= 0 && x <= map.width && y <= map.height) map.take([x, y]);
  keepView();
}

for (const input of [...layers(), $("threshold")]) input.addEventListener("change", keepView);
whenTimeChanges(keepView);
const follow = map.onPlace;
map.onPlace = (place, drawing) => { follow(place, drawing); keepView(); };
addEventListener("hashchange", () => { wanted = new URLSearchParams(location.hash.slice(1)); showView(); });
