// Telecommands: the buttons that send them, and the stages that each has passed.

import { map } from "./layers.js";
import { send } from "./net.js";
import { isSent } from "./preview.js";
import { $, attempt, numberIn, state } from "./state.js";
import { duration, element, utc, words } from "./words.js";

const SHOWN = 40;
const look = (stage) => (stage === "completed" ? "good" : ["rejected", "failed", "expired", "lost"].includes(stage) ? "bad" : "");
const onCommands = []; // called when a command is new or has passed a stage

export const whenCommandsChange = (callback) => onCommands.push(callback);

// Previews a command and sends it if the operator says so; resolves with whether it was sent.
export async function command(wanted) {
  const expires = $("expires");
  if (expires.value !== "" || expires.validity.badInput) wanted.expires_in_s = numberIn(expires);
  if (!await isSent(wanted)) return false;
  takeCommand(await send("command", wanted));
  return true;
}

export function takeCommand(status) {
  const known = state.commands.get(status.command.command_id);
  if (known && known.stages.length > status.stages.length) return; // overtaken by a report
  state.commands.set(status.command.command_id, status);
  showCommands();
}

export function showCommands() {
  const statuses = [...state.commands.values()].reverse();
  $("command-note").textContent = statuses.length ? `${statuses.length} sent` : "none sent yet";
  $("commands").replaceChildren(...statuses.slice(0, SHOWN).map(row));
  for (const callback of onCommands) callback();
}

function row({ command: sent, stages, end, by }) {
  const first = stages[0]?.at ?? 0, why = stages.find(({ stage }) => stage === end)?.why;
  const about = sent.target_m ? ` (${sent.target_m.join(", ")}) m` : sent.area_id ? ` ${sent.area_id}` : "";
  const passed = stages.map(({ stage, at, why: reason }) => element("li", { class: look(stage), title: reason || utc(at) }, element("b", {}, stage), ` +${duration((at - first) / 1e9)}`));
  const item = element("li", { class: end ? (look(end) === "good" ? "done" : "failed") : "open" },
    element("div", { class: "head" }, `${words(sent.kind)}${about}`, element("span", { class: "by dim" }, by ? `by ${by}` : ""), element("span", { class: "dim num" }, utc(first).slice(11))),
    element("ol", { class: "stages num" }, ...passed), ...(why ? [element("p", { class: "dim" }, why)] : []));
  item.dataset.id = sent.command_id;
  item.dataset.stages = JSON.stringify(stages);
  return item;
}

$("command-buttons").addEventListener("click", (event) => {
  const kind = event.target.dataset?.command;
  if (!kind) return;
  const wanted = { kind };
  if (kind === "go_to") wanted.target_m = map.chosen;
  attempt(() => command(wanted));
});
