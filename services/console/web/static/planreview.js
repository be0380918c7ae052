// Plan review: the plan that waits for the operator, drawn on the map; approved, without some samples, or sent back.

import { map } from "./layers.js";
import { askJson, send } from "./net.js";
import { fact } from "./rover.js";
import { $, attempt, state, toast } from "./state.js";
import { showTimeline } from "./timeline.js";
import { duration, element, fixed, grouped } from "./words.js";

let shown = null;   // the number of the proposal that is shown
let asking = false;

// Shows what waits, if the ground's status names another proposal than the one that is shown.
export function showPlan() {
  const waits = state.status?.proposal ?? null;
  if (waits === shown || asking) return;
  asking = true;
  askJson("plan").then(({ proposal }) => draw(proposal)).catch(() => {}) // the next status asks again
    .finally(() => { asking = false; });
}

function draw(proposal) {
  shown = proposal?.proposal ?? null;
  state.proposal = proposal;
  showTimeline();
  $("plan-card").hidden = proposal === null;
  map.proposal = proposal === null ? null : { path: proposal.plan.path_m, samples: proposal.plan.samples, dropped: new Set() };
  map.draw();
  if (proposal === null) return;
  const { plan, length_m, lasts_s, last } = proposal;
  $("plan-title").textContent = `Plan of round ${plan.round} waits for approval`;
  $("plan-facts").replaceChildren(...[
    ["Path", `${grouped(length_m)} m`], ["Takes", lasts_s === null ? "never: too little sun" : duration(lasts_s)],
    ["Information", `${fixed(plan.information_nats, 2)} nat`], ["Rounds after it", last ? "none" : "more"],
  ].map(fact));
  $("plan-samples").replaceChildren(...plan.samples.map(sampleRow));
}

function sampleRow({ sample_id, x_m, y_m }) {
  const box = element("input", { type: "checkbox", checked: true, value: sample_id });
  box.addEventListener("change", () => {
    map.proposal.dropped[box.checked ? "delete" : "add"](sample_id);
    map.draw();
  });
  return element("li", {}, element("label", { class: "inline" }, box, `${sample_id} at (${fixed(x_m, 1)}, ${fixed(y_m, 1)}) m`));
}

async function decide(verdict) {
  const proposal = shown, drop = verdict === "approve" ? [...map.proposal.dropped] : [];
  const { proposal: next } = await send("plan", { proposal, verdict, drop });
  toast(verdict === "approve" ? `Plan approved${drop.length ? ` without ${drop.join(", ")}` : ""}` : "Plan sent back");
  draw(next);
}

$("plan-approve").addEventListener("click", () => attempt(() => decide("approve")));
$("plan-back").addEventListener("click", () => attempt(() => decide("send_back")));
