// The page: what the server sends is kept in `state` and shown by its panel.

import { showAlarms } from "./alarms.js";
import { Chart } from "./charts.js";
import { showCommands, takeCommand, whenCommandsChange } from "./commands.js";
import { forgetMap, groundIsHeard, map, mapIsPromised, refreshHistory, wantMap, whenTimeChanges } from "./layers.js";
import { picture, showLink } from "./linkpanel.js";
import "./deliberate.js";
import { everyFrame, redraw, setFlying } from "./frames.js";
import { heard, isGroundSilent, isTimeKnown, showLiveness } from "./liveness.js";
import { showLog } from "./log.js";
import { askJson, listen, send } from "./net.js";
import { estimateIsAt, showAreas, takeInterests } from "./areas.js";
import "./measure.js";
import "./picture.js";
import { placeIsAt } from "./place.js";
import { doubtPlan, showPlan } from "./planreview.js";
import { forgetPreview } from "./preview.js";
import { showRecording, takeRecording } from "./recording.js";
import { lookAtRehearsal } from "./rehearsal.js";
import { placeRover, showAge, showRover } from "./rover.js";
import { $, keepClock, now, rewrite, sinceStart, state } from "./state.js";
import { takeStack } from "./stacks.js";
import { showTimeline } from "./timeline.js";
import { showView } from "./view.js";
import { elapsed, grouped, utc } from "./words.js";

const charts = {
  rmse_ppb: new Chart($("chart-rmse"), 3), mean_std_ppb: new Chart($("chart-std"), 3),
  energy_wh: new Chart($("chart-energy"), 0, true), queue: new Chart($("chart-queue"), 0, true, true),
};

whenTimeChanges(placeRover);
whenTimeChanges(() => {
  for (const chart of Object.values(charts)) chart.setMark(state.past ? sinceStart(state.past.mission_time_ns) : null);
});
whenCommandsChange(() => redraw(showAreas, showLog, showTimeline));

listen({
  state: takeAll,
  clock: takeClock,
  beat: (beat) => {
    if (isGroundSilent(state.liveness) && !isGroundSilent(beat.liveness)) groundIsHeard();
    takeClock(beat);
    heard(beat.liveness);
    refreshHistory().then(showView);
  },
  // Of these only the fields come that are others than before.
  status: (status) => {
    state.status = { ...state.status, ...status };
    if (status.map_revision !== undefined) mapIsPromised();
    redraw(showStatus, showMap);
  },
  rover: (rover) => { state.rover = { ...state.rover, ...rover }; redraw(showRover); },
  link: (link) => { state.link = { ...state.link, ...link }; redraw(showLink); },
  contacts: (contacts) => { state.contacts = { ...state.contacts, ...contacts }; redraw(showLog, showTimeline); },
  event: (event) => { state.events.push(event); redraw(showLog, showTimeline); },
  entry: (entry) => { state.entries.push(entry); redraw(showLog, showTimeline); },
  mode: (mode) => { state.modes.push(mode); redraw(showTimeline); },
  command: takeCommand,
  curve: ({ name, points }) => charts[name].extend(points),
  interests: takeInterests,
  stack: ({ stack }) => takeStack(stack),
  alarms: (alarms) => { state.alarms = alarms; redraw(showAlarms, showLog, showTimeline); },
}, () => { state.connected = false; showLiveness(); });

// A hidden page fetches no map; it does when it is visible again.
function showMap() {
  if (document.hidden || !state.status) return;
  wantMap();
  mapIsAt(state.status.map_revision);
}
document.addEventListener("visibilitychange", showMap);

let newestMap = null;
function mapIsAt(revision) {
  if (revision === newestMap) return;
  newestMap = revision;
  placeIsAt(revision);
  estimateIsAt(revision);
}

function takeAll(all) {
  state.recording = all.recording;
  takeClock(all.clock);
  takeRecording(all.recording);
  state.status = all.status;
  state.rover = all.rover;
  state.link = all.link;
  for (const fact of ["alarms", "events", "entries", "modes", "contacts"]) state[fact] = all[fact];
  state.commands = new Map(all.commands.map((status) => [status.command.command_id, status]));
  askJson("session").then(takeSession).catch(() => {}); // the stream says that the connection is lost
  forgetPreview();
  doubtPlan();
  $("mission").textContent = all.mission;
  document.title = all.recording ? `${all.mission}: recording` : `${all.mission}: helium-3 live map`;
  for (const [name, chart] of Object.entries(charts)) chart.set(all.curves[name]);
  showStatus(); showRover(); showLink(); showCommands(); showAlarms(); showLog(); showTimeline();
  takeStack(all.stack);
  heard(all.liveness);
  forgetMap();
  if (!state.recording) lookAtRehearsal();
  askJson("interest").then(takeInterests).catch(() => {}); // none before the ground answers
  refreshHistory(true).then(showView);
}

// What is hidden here is refused by the server as well.
function takeSession({ name, commands, controls, warning, logged_in }) {
  $("log-out").hidden = !logged_in;
  document.body.classList.toggle("commanding", commands);
  document.body.classList.toggle("controlling", controls);
  $("authority").textContent = state.recording ? "recording" : commands && controls ? "command authority" : commands ? "commands" : controls ? "link and clock" : "read-only";
  $("authority").title = name;
  $("authority").classList.toggle("warn", commands || controls);
  rewrite($("warning"), warning ?? "");
  $("warning").hidden = !warning;
}

function takeClock(clock) {
  keepClock(clock);
  picture.rate = clock.rate;
  const { rate, mode } = clock;
  state.pace = mode === "lockstep" && !state.recording ? "lockstep" : mode === null && !state.recording ? "–" : rate === 0 ? "paused" : rate === 1 ? "real time" : `${grouped(rate, rate % 1 ? 2 : 0)}x`;
}

function showStatus() {
  const status = state.status;
  showPhase();
  showPlan();
  if (!status) return;
  document.body.classList.toggle("simulated", Boolean(status.score));
  $("progress").textContent = `${status.samples} of ${status.samples_total}`;
  $("goal").hidden = !status.goal;
  if (status.goal) {
    rewrite($("goal"), `Goal: ${status.goal.text.replace(/^the goal /, "")}`);
    $("goal").classList.toggle("ok", status.goal.holds);
    $("goal").classList.toggle("out", !status.goal.holds && status.goal.forecast?.reachable === false);
  }
  $("progress-bar").style.width = `${(100 * status.samples) / Math.max(1, status.samples_total)}%`;
}

function showPhase() {
  const { status } = state;
  const phase = status ? `${status.phase}${status.detail ? ": " + status.detail : ""} · round ${status.round} of ${status.rounds} · planner ${status.planner}` : "no status yet";
  rewrite($("phase"), phase);
}

setFlying(() => picture.flies && isTimeKnown() && now() !== null, () => picture.draw(now()));
everyFrame(() => {
  const time = now();
  if (time === null) return;
  const known = isTimeKnown();
  rewrite($("utc"), known ? utc(time) : "not known");
  rewrite($("elapsed"), known ? elapsed(sinceStart(time)) : "not known");
  rewrite($("pace"), known ? state.pace : "not known");
  if (known) showAge(time);
  showRecording();
});

$("log-out").addEventListener("click", async () => {
  await send("logout", {}).then(() => location.reload(), (error) => {
    rewrite($("warning"), `not logged out: ${error.message}`);
    $("warning").hidden = false;
  });
});

const remembered = localStorage.getItem("theme");
if (remembered) document.documentElement.dataset.theme = remembered;
$("theme").addEventListener("click", () => {
  const light = getComputedStyle(document.documentElement).colorScheme.startsWith("light");
  document.documentElement.dataset.theme = light ? "dark" : "light";
  localStorage.setItem("theme", document.documentElement.dataset.theme);
  map.draw();
});
matchMedia("(prefers-color-scheme: light)").addEventListener("change", () => map.draw());
