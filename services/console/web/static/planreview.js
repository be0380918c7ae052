// Plan review: the plan that waits for the operator, drawn on the map; approved, without some samples, revised, or sent
// back. Samples are dragged on the map, added there, put in another order, or written as numbers. Until the ground has found
// the ways between them, the map shows straight legs, and nothing can be approved.

import { map } from "./layers.js";
import { askJson, send } from "./net.js";
import { inserted, isRevised, moved, placeOf, shifted, stopsOf, taken, ticked } from "./planstops.js";
import { fact } from "./rover.js";
import { $, attempt, numberIn, rewrite, state, toast } from "./state.js";
import { showTimeline } from "./timeline.js";
import { duration, element, fixed, grouped } from "./words.js";

let shown = null;     // the number of the proposal that is shown
let asking = false;   // whether the server is asked for the plan, or told what to do about it
let doubted = false;  // whether another mission may have a plan under the number that is shown
let stops = [];       // the samples as they are edited
let compared = null;  // the figures of the plan before it was revised here

const HINT = "Drag a sample on the map, write its place, add some, or change their order; what is not ticked is not taken.";
const isEdited = () => isRevised(stops, state.proposal.plan) || taken(stops).length < stops.length;
const mayEdit = () => document.body.classList.contains("commanding");

// Shows what waits, if the ground's status names another proposal than the one that is shown.
export function showPlan() {
  const waits = state.status?.proposal ?? null;
  if (asking || (waits === shown && !(doubted && shown !== null))) return;
  asking = true;
  askJson("plan").then(({ proposal }) => {
    if (!isShown(proposal)) draw(proposal);
    doubted = false;
  }).catch(() => {}) // the next status asks again
    .finally(() => { asking = false; });
}

const isShown = (proposal) => (proposal?.proposal ?? null) === shown && JSON.stringify(proposal?.plan) === JSON.stringify(state.proposal?.plan);

// The page has connected anew, perhaps to another mission: the plan is asked for before anything is decided on it.
export function doubtPlan() { doubted = true; }

// before: the figures of the plan that this page has decided on; null if another operator or the ground has.
function draw(proposal, before = null) {
  if (before === null && shown !== null && isEdited()) {
    toast(`${proposal ? "Another plan waits now" : "The plan waits no more"}; your changes were of the one before, and nothing of them was sent`, true);
  }
  shown = proposal?.proposal ?? null;
  state.proposal = proposal;
  compared = before;
  showTimeline();
  $("plan-card").hidden = proposal === null;
  setAdding(false);
  if (proposal === null) { stops = []; map.proposal = null; map.draw(); return; }
  stops = stopsOf(proposal.plan);
  const { plan, length_m, lasts_s, last } = proposal;
  const than = (name, text) => (compared?.[name] && compared[name] !== text ? `${text}, was ${compared[name]}` : text);
  const figures = { length: `${grouped(length_m)} m`, lasts: lasts_s === null ? "never: too little sun" : duration(lasts_s), nats: `${fixed(plan.information_nats, 2)} nat` };
  $("plan-title").textContent = `Plan of round ${plan.round} waits for approval`;
  $("plan-facts").replaceChildren(...[
    ["Path", than("length", figures.length)], ["Takes", than("lasts", figures.lasts)],
    ["Information", than("nats", figures.nats)], ["Rounds after it", last ? "none" : "more"],
  ].map(fact));
  $("plan-facts").dataset.figures = JSON.stringify(figures);
  showStops();
}

// --- the samples ----------------------------------------------------------------------------------------------------

function edit(next, focus = null) {
  stops = next;
  showStops();
  if (focus) ($("plan-samples").querySelector(`[data-name="${CSS.escape(focus.name)}"] .${focus.what}`) ?? $("plan-add")).focus();
}

function showStops(selected = null) {
  const { plan } = state.proposal, revised = isRevised(stops, plan), way = [plan.path_m[0], ...taken(stops).map(placeOf)];
  map.proposal = { path: revised ? way : plan.path_m, checked: !revised, samples: stops, selected, get editable() { return mayEdit(); } };
  map.draw();
  $("plan-samples").replaceChildren(...stops.map(row));
  showButtons(revised);
}

function showButtons(revised) {
  const dropped = stops.filter((stop) => !stop.taken).length;
  $("plan-approve").disabled = revised;
  $("plan-check").disabled = !revised || taken(stops).length === 0;
  $("plan-back").disabled = false;
  $("plan-undo").disabled = !revised && dropped === 0;
  $("plan-note").classList.remove("outdated");
  rewrite($("plan-note"), revised ? "Changed: the ground has not found the ways yet, so the map shows straight legs. Check the changes, then approve." : dropped ? `Approve sends the plan without ${dropped} of its ${stops.length} samples; the rover drives by.` : HINT);
}

function row(stop, index) {
  const box = element("input", { type: "checkbox", checked: stop.taken, value: stop.name, class: "taken" });
  box.addEventListener("change", () => edit(ticked(stops, index, box.checked), { name: stop.name, what: "taken" }));
  const axis = (name, key, at) => {
    const input = element("input", { type: "number", step: "any", value: fixed(stop[key], 1), class: name });
    input.setAttribute("aria-label", `${name} of ${stop.name} [m]`);
    input.dataset.name = `${name} of ${stop.name}`;
    input.addEventListener("change", () => attempt(async () => {
      const place = placeOf(stops[index]);
      place[at] = numberIn(input);
      edit(moved(stops, index, place), { name: stop.name, what: name });
    }));
    input.addEventListener("focus", () => select(index));
    return element("label", { class: "inline" }, `${name} `, input);
  };
  const shift = (by, sign, what) => {
    const button = element("button", { type: "button", class: `ghost ${what}`, disabled: index + by < 0 || index + by >= stops.length, title: what }, sign);
    button.setAttribute("aria-label", `${stop.name} ${what}`);
    button.addEventListener("click", () => edit(shifted(stops, index, by), { name: stop.name, what }));
    return button;
  };
  const item = element("li", {}, element("label", { class: "inline stop" }, box, `${index + 1}. ${stop.name}`, element("span", { class: "watchers" }, ` at (${fixed(stop.x_m, 1)}, ${fixed(stop.y_m, 1)}) m`)),
    element("span", { class: "commanders row-actions" }, axis("x", "x_m", 0), axis("y", "y_m", 1), shift(-1, "↑", "earlier"), shift(1, "↓", "later")));
  item.dataset.name = stop.name;
  return item;
}

function select(index) {
  if (!map.proposal || map.proposal.selected === index) return;
  map.proposal.selected = index;
  map.draw();
}

// --- on the map -----------------------------------------------------------------------------------------------------

map.onStop = (index, place) => {
  if (place === null) { select(index); return; }
  stops = moved(stops, index, place);
  showStops(index);
};

function setAdding(on) {
  if (on && map.drawing) $("draw").click();
  if (on && map.measuring) $("measure").click();
  map.adding = on;
  $("plan-add").setAttribute("aria-pressed", String(on));
  if (on) $("map").focus({ preventScroll: true });
}
map.onPlace.push((place, what) => {
  if (what !== "stop" || !state.proposal) return;
  edit(inserted(stops, state.proposal.plan.path_m[0], place));
  map.onSay(`sample added, ${taken(stops).length} of the plan`);
});
$("plan-add").addEventListener("click", () => setAdding(!map.adding));
for (const id of ["draw", "measure"]) $(id).addEventListener("click", () => setAdding(false)); // one at a time
$("map").addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if ((event.key === "a" || event.key === "A") && state.proposal && mayEdit()) setAdding(!map.adding);
  if (event.key === "Escape" && map.adding) setAdding(false);
});

// --- the decision ---------------------------------------------------------------------------------------------------

// Decides on the plan that is shown; gives what waits then. Until the answer is here the status asks for no plan: this page
// would take the one that it has made itself for another operator's.
async function decided(document) {
  if (doubted) throw new Error("The page has connected anew and asks for the plan: nothing was sent");
  asking = true;
  for (const id of ["plan-approve", "plan-check", "plan-back"]) $(id).disabled = true;
  try {
    return (await send("plan", { proposal: shown, ...document })).proposal;
  } catch (error) {
    showButtons(isRevised(stops, state.proposal.plan));
    rewrite($("plan-note"), error.message);
    $("plan-note").classList.add("outdated");
    throw error;
  } finally { asking = false; }
}

async function decide(verdict) {
  const drop = verdict === "approve" ? stops.filter((stop) => !stop.taken).map(({ name }) => name) : [];
  const next = await decided({ verdict, drop });
  toast(verdict === "approve" ? `Plan approved${drop.length ? ` without ${drop.join(", ")}` : ""}` : "Plan sent back");
  draw(next, {});
}

async function revise() {
  const figures = JSON.parse($("plan-facts").dataset.figures);
  rewrite($("plan-note"), "The ground looks for the ways …");
  const next = await decided({ verdict: "revise", places_m: taken(stops).map(placeOf) });
  draw(next, figures);
  rewrite($("plan-note"), "Checked: the ground has found the ways. Approve the plan, or change it further.");
}

addEventListener("beforeunload", (event) => { if (shown !== null && isEdited()) event.preventDefault(); }); // the browser asks first

$("plan-approve").addEventListener("click", () => attempt(() => decide("approve")));
$("plan-back").addEventListener("click", () => attempt(() => decide("send_back")));
$("plan-check").addEventListener("click", () => attempt(revise));
$("plan-undo").addEventListener("click", () => { edit(stopsOf(state.proposal.plan)); });
