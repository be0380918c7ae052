// The page: what comes is kept here, shown in its panel, and what the operator does goes out from here.

import { Chart } from "./charts.js";
import { LinkPicture, describe } from "./link.js";
import { SiteMap } from "./map.js";
import { askJson, askLayer, listen, send } from "./net.js";
import { duration, elapsed, element, fixed, grouped, utc, words } from "./words.js";

const $ = (id) => document.getElementById(id);
const ENDS = { completed: "good", rejected: "bad", failed: "bad", expired: "bad", lost: "bad" };
const ALERTS = new Set(["blocked", "safe_mode_entered", "low_energy", "plan_rejected", "round_aborted", "instrument_silent"]);
const NAMES = { mean: "helium-3", std: "standard deviation", information: "information of one measurement", exceedance: "probability of more than", traversable: "0 closed, 1 open" };

const state = { clock: null, received: 0, status: null, rover: null, link: null, commands: new Map(), alarms: [], revisions: [], past: null, interests: [], connected: false };
const link = new LinkPicture($("link"));
const map = new SiteMap($("map"), takePlace, showHover);
const charts = {
  rmse_ppb: new Chart($("chart-rmse"), 3), mean_std_ppb: new Chart($("chart-std"), 3),
  energy_wh: new Chart($("chart-energy"), 0, true), queue: new Chart($("chart-queue"), 0, true, true),
};
const colours = await askJson("colours");

// --- time -----------------------------------------------------------------------------------------------------------

function now() {
  if (!state.clock) return null;
  return state.clock.now + (performance.now() - state.received) * 1e6 * state.clock.rate;
}

function takeClock(clock) {
  state.clock = clock;
  state.received = performance.now();
  link.rate = clock.rate;
}

const sinceStart = (ns) => (ns - (state.clock?.start_ns ?? 0)) / 1e9;

function everyFrame() {
  const time = now();
  if (time !== null) {
    $("utc").textContent = utc(time);
    $("elapsed").textContent = elapsed(sinceStart(time));
    link.draw(time);
    showAge(time);
  }
  requestAnimationFrame(everyFrame);
}

// --- what comes -----------------------------------------------------------------------------------------------------

listen({
  state: takeAll,
  clock: takeClock,
  beat: (beat) => { takeClock(beat); showPace(beat.silent_s); refreshHistory(); },
  status: (status) => { state.status = status; showStatus(); wantMap(); },
  rover: (rover) => { state.rover = rover; showRover(); },
  link: (status) => { state.link = status; showLink(); },
  event: (event) => { logged(event); },
  command: (status) => { state.commands.set(status.command.command_id, status); showCommands(); },
  curve: ({ name, points }) => charts[name].extend(points),
  alarms: (alarms) => { state.alarms = alarms; showAlarms(); },
}, () => { state.connected = false; $("phase").textContent = "connection lost; trying again …"; });

function takeAll(all) {
  state.connected = true;
  takeClock(all.clock);
  state.status = all.status;
  state.link = all.link;
  state.alarms = all.alarms;
  state.commands = new Map(all.commands.map((status) => [status.command.command_id, status]));
  document.body.classList.toggle("commanding", all.authority);
  $("authority").textContent = all.authority ? "command authority" : "looking on";
  $("authority").classList.toggle("warn", all.authority);
  $("mission").textContent = all.mission;
  document.title = `${all.mission}: He-3 live map`;
  for (const [name, chart] of Object.entries(charts)) chart.set(all.curves[name]);
  $("log").replaceChildren();
  all.events.forEach(logged);
  if (!all.events.length) $("log").append(element("li", { class: "dim" }, "nothing yet since this page's server joined the mission"));
  showStatus(); showRover(); showLink(); showCommands(); showAlarms(); showPace(0);
  fillLinkForm();
  askJson("interest").then(takeInterests).catch(() => {});
  refreshHistory(true);
}

function showPace(silent) {
  const { rate, mode } = state.clock;
  $("pace").textContent = mode === "lockstep" ? "lockstep" : mode === null ? "–" : rate === 0 ? "paused" : rate === 1 ? "real time" : `${grouped(rate)} × life`;
  if (silent > 15) $("phase").textContent = `nothing heard for ${Math.round(silent)} s`;
}

function showStatus() {
  const status = state.status;
  if (!status) return;
  $("phase").textContent = `${status.phase}${status.detail ? ": " + status.detail : ""} · round ${status.round} of ${status.rounds} · planner ${status.planner}`;
  $("progress").textContent = `${status.samples} of ${status.samples_total}`;
  $("progress-bar").style.width = `${(100 * status.samples) / Math.max(1, status.samples_total)}%`;
  if (!state.rover && status.rover) { state.rover = { made_at: status.rover_made_at, ...status.rover }; showRover(); }
}

// --- rover ----------------------------------------------------------------------------------------------------------

function showRover() {
  const rover = state.rover;
  if (!rover) return;
  $("rover-mode").textContent = rover.mode;
  $("rover-mode").className = `chip ${rover.mode === "safe" ? "bad" : ["paused", "charging"].includes(rover.mode) ? "warn" : "good"}`;
  const facts = [
    ["Place", `${fixed(rover.x_m, 1)}, ${fixed(rover.y_m, 1)} m`], ["Heading", `${fixed(rover.heading_deg, 0)}°`],
    ["Driven", `${grouped(rover.driven_m)} m`], ["Drilled", `${fixed(rover.drilled_m, 1)} m`],
    ["Round", `${rover.round} (+${rover.rounds_on_board} aboard)`], ["Waiting for Earth", `${rover.queue_depth} messages`],
  ];
  $("rover-facts").replaceChildren(...facts.map(fact));
  const share = rover.energy_wh / rover.capacity_wh;
  $("energy").textContent = `${grouped(rover.energy_wh)} of ${grouped(rover.capacity_wh)} Wh`;
  $("energy-bar").style.width = `${100 * share}%`;
  $("energy-bar").className = share < .25 ? "low" : "";
  placeRover();
}

function placeRover() {
  const stale = state.alarms.some((alarm) => alarm.kind === "stale" && alarm.active);
  map.rover = state.rover && state.past === null ? { ...state.rover, stale } : null;
  map.draw();
}

function showAge(time) {
  if (!state.rover) return;
  const light = state.link?.conditions.down.one_way_light_time_s ?? 0;
  const age = Math.max(0, (time - state.rover.made_at) / 1e9);
  $("rover-age").textContent = `seen as it was ${duration(Math.max(age, 0))} ago (light ${duration(light)})`;
}

const fact = ([name, value, big]) => element("div", { class: big ? "big" : "" }, element("dt", {}, name), element("dd", {}, value));

// --- link -----------------------------------------------------------------------------------------------------------

function showLink() {
  const status = state.link;
  if (!status) return;
  link.take(status);
  $("contact").textContent = status.contact ? "in contact" : "NO CONTACT";
  $("contact").className = `chip ${status.contact ? "good" : "bad"}`;
  $("link-summary").textContent = describe(status);
  const head = ["", "sent", "delivered", "in flight", "waiting", "lost"];
  const row = (name, c) => [name, c.offered, c.delivered, c.in_flight, c.waiting, c.lost + c.dropped_out_of_contact + c.dropped_queue_full];
  const line = (cells, tag) => element("tr", {}, ...cells.map((cell, index) => element(index ? tag : "th", {}, String(cell))));
  $("counts").replaceChildren(line(head, "th"), line(row("up", status.up), "td"), line(row("down", status.down), "td"));
}

function fillLinkForm() {
  const status = state.link, form = $("link-form").elements;
  if (!status || $("link-form").contains(document.activeElement)) return;
  form.one_way_light_time_s.value = status.conditions.down.one_way_light_time_s;
  form.loss.value = status.conditions.down.loss;
  form.rate_bit_s.value = status.conditions.down.rate_bit_s ?? "";
  form.contact.value = status.contact_forced === null ? "schedule" : status.contact_forced ? "on" : "off";
}

$("link-form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const form = event.target.elements, change = {};
  if (form.one_way_light_time_s.value !== "") change.one_way_light_time_s = Number(form.one_way_light_time_s.value);
  if (form.loss.value !== "") change.loss = Number(form.loss.value);
  if (form.rate_bit_s.value === "") change.unlimited_rate = true; else change.rate_bit_s = Number(form.rate_bit_s.value);
  if (form.contact.value === "schedule") change.contact_as_scheduled = true; else change.contact = form.contact.value === "on";
  await attempt(async () => { state.link = await send("link", change); showLink(); toast("link set"); });
});

// --- the map --------------------------------------------------------------------------------------------------------

const chosenLayer = () => document.querySelector("input[name=layer]:checked").value;
let loading = false, wanted = false, shownKey = "";

function wantMap() {
  if (loading) { wanted = true; return; }
  loading = true;
  loadMap().catch((error) => { if (state.connected && !/no map yet|nobody/.test(error.message)) toast(error.message, true); })
    .finally(() => { loading = false; if (wanted) { wanted = false; setTimeout(wantMap, 250); } });
}

async function loadMap() {
  const layer = chosenLayer(), as_of = state.past?.revision ?? null;
  const threshold = layer === "exceedance" ? Number($("threshold").value) : null;
  const revision = as_of ?? state.status?.map_revision ?? 0;
  const key = `${layer} ${threshold} ${revision}`;
  const track = askJson("map/track", { as_of });
  if (key !== shownKey) {
    const got = await askLayer({ layer, threshold, as_of });
    // By the time it comes, another may be wanted.
    if (layer === chosenLayer() && as_of === (state.past?.revision ?? null)) {
      // The ground says that there is a new map a moment before it answers from it.
      shownKey = got.about.revision >= revision || as_of !== null ? key : "";
      if (!shownKey) wanted = true;
      const range = layer === "exceedance" || layer === "traversable" ? [0, 1] : [got.about.low, got.about.high];
      const stops = colours.stops[colours.of_layer[layer]];
      map.setLayer(got, stops, range);
      showScale(layer, stops, range, got.about);
      $("map").dataset.shown = JSON.stringify({ layer, revision: got.about.revision, samples: got.about.samples });
    }
  }
  map.track = await track;
  map.draw();
}

function showScale(layer, stops, [low, high], about) {
  const canvas = $("colours"), context = canvas.getContext("2d");
  canvas.width = 512;
  const gradient = context.createLinearGradient(0, 0, 512, 0);
  stops.forEach((stop, index) => gradient.addColorStop(index / (stops.length - 1), stop));
  context.fillStyle = gradient;
  context.fillRect(0, 0, 512, canvas.height);
  const unit = about.unit === "1" ? "" : ` ${about.unit}`;
  const middle = layer === "exceedance" ? `${NAMES[layer]} ${about.threshold_ppb} ppb` : NAMES[layer];
  const digits = high - low < .5 ? 3 : 2;
  $("ticks").replaceChildren(element("span", {}, low.toFixed(unit ? digits : 0) + unit), element("span", {}, middle), element("span", {}, high.toFixed(unit ? digits : 0) + unit));
}

for (const input of document.querySelectorAll("input[name=layer]")) input.addEventListener("change", () => {
  $("threshold-field").hidden = chosenLayer() !== "exceedance";
  wantMap();
});
$("threshold").addEventListener("change", wantMap);
$("show-paths").addEventListener("change", (event) => { map.show.paths = event.target.checked; map.draw(); });
$("show-samples").addEventListener("change", (event) => { map.show.samples = event.target.checked; map.draw(); });

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

// --- a place, an area -----------------------------------------------------------------------------------------------

let asked = 0;
async function takePlace(place, drawing) {
  if (drawing) return showArea();
  $("go-to").disabled = false;
  await showPlace();
}

async function showPlace() {
  if (!map.chosen) return;
  const [x, y] = map.chosen, mine = ++asked;
  await attempt(async () => {
    const point = await askJson("map/point", { x, y, threshold: Number($("threshold").value), as_of: state.past?.revision });
    if (mine !== asked) return;
    $("place-hint").textContent = `(${x}, ${y}) m, revision ${point.revision}`;
    $("place").dataset.point = JSON.stringify(point);
    $("place").replaceChildren(element("dl", { class: "facts" }, ...[
      ["Helium-3", `${fixed(point.mean_ppb, 3)} ± ${fixed(point.std_ppb, 3)} ppb`, true],
      ["95 % interval", `${fixed(point.mean_ppb - 1.96 * point.std_ppb)} to ${fixed(point.mean_ppb + 1.96 * point.std_ppb)} ppb`],
      [`More than ${$("threshold").value} ppb`, `${(100 * point.exceedance).toFixed(1)} %`],
      ["One sample tells", `${fixed(point.information_nats, 2)} nat`],
      ["Ground", point.traversable ? "traversable" : "not traversable"],
    ].map(fact)));
  });
}

function showArea() {
  const corners = map.draft;
  $("undo").disabled = $("clear").disabled = corners.length === 0;
  $("area").hidden = corners.length < 3;
  $("place-hint").textContent = map.drawing ? `${corners.length} corners; click to add, three at least` : "";
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
  $("draw").textContent = on ? "Done drawing" : "Draw area";
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
  const cutoff = Number($("cutoff").value);
  const got = await askJson("map/resource", { polygon: map.draft.flat().join(","), cutoff_ppb: cutoff, as_of: state.past?.revision });
  const between = (interval, digits, scale = 1) => `${fixed(interval.expected * scale, digits)} (${fixed(interval.low * scale, digits)} to ${fixed(interval.high * scale, digits)})`;
  const rows = [
    ["He-3 a metre deep", `${between(got.mass_kg_per_m, 2, 1000)} g/m`],
    ["Mean abundance", `${between(got.mean_ppb, 3)} ppb`],
    [`Area above ${cutoff} ppb`, `${between(got.area_above_m2, 0)} m²`],
    [`of it with ${Math.round(got.probability * 100)} % certainty`, `${grouped(got.confident_area_m2)} m²`],
  ];
  $("estimate-result").replaceChildren(element("table", { class: "result num" }, ...rows.map(([name, value]) => element("tr", {}, element("td", {}, name), element("td", {}, value)))),
    element("p", { class: "dim" }, `${Math.round(got.probability * 100)} % intervals of the joint posterior; bulk density ${got.bulk_density_kg_m3} kg/m³`));
}));

$("send-keepout").addEventListener("click", () => attempt(async () => {
  await command({ kind: "set_keep_out", area_id: $("area-name").value, polygon_m: map.draft });
  areaSent();
}));
$("send-interest").addEventListener("click", (event) => {
  if (event.target.id === "weight") return;
  attempt(async () => {
    takeInterests(await send("interest", { area_id: $("area-name").value, polygon_m: map.draft, weight: Number($("weight").value) }));
    toast("the planner knows of the area");
    areaSent();
  });
});

function areaSent() {
  map.draft = [];
  setDrawing(false);
  const number = Number(/(\d+)$/.exec($("area-name").value)?.[1] ?? 0) + 1;
  $("area-name").value = `area-${number}`;
}

function takeInterests({ areas }) { state.interests = areas; showAreas(); }

function showAreas() {
  const keepOuts = new Map();
  for (const { command, stages } of state.commands.values()) {
    if (command.kind !== "set_keep_out" || stages.some(({ stage }) => ["rejected", "expired", "lost", "failed"].includes(stage))) continue;
    if (command.polygon_m) keepOuts.set(command.area_id, command.polygon_m); else keepOuts.delete(command.area_id);
  }
  map.areas = [
    ...[...keepOuts].map(([name, corners]) => ({ name, corners, kind: "keepout" })),
    ...state.interests.map(({ area_id, polygon_m, weight }) => ({ name: `${area_id} ×${weight}`, corners: polygon_m, kind: "interest" })),
  ];
  map.draw();
}

// --- commands -------------------------------------------------------------------------------------------------------

async function command(wantedCommand) {
  const expires = Number($("expires").value);
  if (expires > 0) wantedCommand.expires_in_s = expires;
  const status = await send("command", wantedCommand);
  state.commands.set(status.command.command_id, status);
  showCommands();
}

$("command-buttons").addEventListener("click", (event) => {
  const kind = event.target.dataset?.command;
  if (!kind) return;
  const wantedCommand = { kind };
  if (kind === "go_to") wantedCommand.target_m = map.chosen;
  attempt(() => command(wantedCommand));
});

function showCommands() {
  const statuses = [...state.commands.values()].reverse();
  $("command-note").textContent = statuses.length ? `${statuses.length} sent` : "none sent yet";
  $("commands").replaceChildren(...statuses.slice(0, 40).map(({ command: sent, stages }) => {
    const first = stages[0]?.at ?? 0, last = stages.at(-1);
    const end = stages.map(({ stage }) => ENDS[stage]).find(Boolean);
    const about = sent.target_m ? ` (${sent.target_m.join(", ")}) m` : sent.area_id ? ` ${sent.area_id}` : "";
    const shown = stages.map(({ stage, at, why }) => element("li", { class: ENDS[stage] ?? "", title: why || utc(at) }, element("b", {}, stage), ` +${duration((at - first) / 1e9)}`));
    const why = last?.why ? [element("p", { class: "dim" }, last.why)] : [];
    const item = element("li", { class: end === "good" ? "done" : end === "bad" ? "failed" : "open" },
      element("div", { class: "head" }, `${words(sent.kind)}${about}`, element("span", { class: "dim num" }, utc(first).slice(11))), element("ol", { class: "stages num" }, ...shown), ...why);
    item.dataset.id = sent.command_id;
    item.dataset.stages = JSON.stringify(stages);
    return item;
  }));
  showAreas();
}

// --- alarms, log, time ----------------------------------------------------------------------------------------------

const alarmRows = new Map();

function alarmRow(id) {
  const row = element("div", { role: "alert" }, element("span", { class: "kind" }), element("span", { class: "text" }),
    element("span", { class: "dim num" }), element("button", { type: "button" }, "Acknowledge"));
  row.lastChild.addEventListener("click", () => attempt(() => send("acknowledge", { id })));
  return row;
}

// Rows stay where they are while their words change: a click or the keyboard's focus on a button outlives the news.
function showAlarms() {
  const ids = new Set(state.alarms.map((alarm) => alarm.id));
  for (const [id, row] of alarmRows) if (!ids.has(id)) { row.remove(); alarmRows.delete(id); }
  state.alarms.forEach((alarm, place) => {
    const known = alarmRows.get(alarm.id), raisedAgain = known?.classList.contains("seen") && !alarm.acknowledged;
    if (raisedAgain) known.remove();
    const row = known && !raisedAgain ? known : alarmRow(alarm.id);
    alarmRows.set(alarm.id, row);
    const [kind, text, when] = row.children;
    row.className = alarm.acknowledged ? "alarm seen" : "alarm";
    row.dataset.kind = alarm.kind;
    rewrite(kind, words(alarm.kind));
    rewrite(text, alarm.text);
    rewrite(when, `${utc(alarm.raised_at).slice(11)}${alarm.times > 1 ? `, ${alarm.times} times` : ""}${alarm.active ? "" : ", over"}`);
    if (alarm.acknowledged && row.lastChild.tagName === "BUTTON") row.lastChild.replaceWith(element("span", { class: "dim" }, "acknowledged"));
    if ($("alarms").children[place] !== row) $("alarms").insertBefore(row, $("alarms").children[place] ?? null);
  });
  placeRover();
}

function rewrite(node, text) { if (node.textContent !== text) node.textContent = text; }

function logged(event) {
  const about = [event.round ? `round ${event.round}` : "", event.sample_id ?? "", `(${fixed(event.x_m, 1)}, ${fixed(event.y_m, 1)}) m`, event.detail].filter(Boolean).join(" · ");
  const delay = (event.received_at - event.at) / 1e9;
  const item = element("li", { class: ALERTS.has(event.kind) ? "alert" : "" },
    element("span", { class: "num", title: utc(event.at) }, elapsed(sinceStart(event.at)).slice(3)), element("span", { class: "kind" }, words(event.kind)),
    element("span", {}, about, element("span", { class: "dim num" }, delay > 0 ? ` · here ${duration(delay)} later` : "")));
  $("log").querySelector("li.dim")?.remove();
  $("log").prepend(item);
  while ($("log").children.length > 300) $("log").lastChild.remove();
}

let historyAt = 0;
async function refreshHistory(atOnce = false) {
  if (!atOnce && (performance.now() - historyAt < 1900 || document.hidden)) return;
  historyAt = performance.now();
  try {
    const { site, revisions } = await askJson("map/history");
    map.site = site;
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
  $("time-label").textContent = `${state.past ? "" : "now · "}${elapsed(sinceStart(shown.mission_time_ns))} · ${shown.samples} samples`;
  $("past").textContent = `as it was at ${elapsed(sinceStart(shown.mission_time_ns))}`;
  for (const chart of Object.values(charts)) { chart.mark = state.past ? sinceStart(shown.mission_time_ns) : null; chart.draw(); }
}

$("time").addEventListener("input", (event) => {
  const index = Number(event.target.value);
  state.past = index >= state.revisions.length - 1 ? null : state.revisions[index];
  showTime(); placeRover(); wantMap(); showPlace();
});
$("live").addEventListener("click", () => {
  state.past = null;
  $("time").value = $("time").max;
  showTime(); placeRover(); wantMap(); showPlace();
});

// --- everything else ------------------------------------------------------------------------------------------------

async function attempt(what) {
  try { await what(); } catch (error) { toast(error.message, true); }
}

function toast(message, bad = false) {
  const shown = element("div", { class: bad ? "bad" : "" }, message);
  $("toast").append(shown);
  setTimeout(() => shown.remove(), bad ? 8000 : 4000);
}

const remembered = localStorage.getItem("theme");
if (remembered) document.documentElement.dataset.theme = remembered;
$("theme").addEventListener("click", () => {
  const light = getComputedStyle(document.documentElement).colorScheme.startsWith("light");
  document.documentElement.dataset.theme = light ? "dark" : "light";
  localStorage.setItem("theme", document.documentElement.dataset.theme);
  map.draw();
});
matchMedia("(prefers-color-scheme: light)").addEventListener("change", () => map.draw());
everyFrame();
