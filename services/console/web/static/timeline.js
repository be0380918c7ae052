// The strip under the map: one axis of mission time for rounds, the rover, commands, contacts and alarms.

import { STEPS_S, colour, pointAt, seeSpan, timeLabel, whenPointedAt, whenSpanSeen, whenThemeChanges } from "./cursor.js";
import { everyFrame } from "./frames.js";
import { map, showMoment, whenTimeChanges } from "./layers.js";
import { isTimeKnown } from "./liveness.js";
import { send } from "./net.js";
import { $, attempt, now, rewrite, sinceStart, state } from "./state.js";
import { contactText, described, deviationText, edges, labelPlace, lanes, moments, placeAt } from "./timelinemodel.js";
import { inAddress, keepView, numbers } from "./view.js";
import { duration, elapsed, element } from "./words.js";

const EVERY_MS = 450, ROW = 13, GAP = 7, AXIS = 20, NAMES_FROM = 560, NAMES = 76, NAMES_SHORT = 58, LEAST_SPAN_S = 30, DRAG_PX = 4, LISTED = 200, AHEAD = 1.12;
const LOOKS = { good: "--good", bad: "--bad", warn: "--warn", accent: "--accent", accent2: "--analysing", dim: "--line", contact: "--good", none: "--bad", critical: "--bad", warning: "--warn", advisory: "--accent", sample: "--sample" };
const canvas = $("timeline"), pen = canvas.getContext("2d");
let shown = [], facts = null, changed = true;
let span = null;      // what is seen [s]; null for the whole mission
let follows = false;  // whether the span moves with the present time
let cursor = null;    // the moment that is pointed at [s]
let drawnAt = null;   // the present when it was drawn last [s]
let lookedAt = -Infinity;

export function showTimeline() { changed = true; }

function look() {
  if (!state.clock || performance.now() - lookedAt < EVERY_MS) return;
  lookedAt = performance.now();
  const time = isTimeKnown() ? now() : null;
  if (!changed && time === facts?.time) return;
  const before = facts;
  facts = moments({
    start_ns: state.clock.start_ns, now_ns: time, heard_ns: state.rover?.made_at, events: state.events, entries: state.entries,
    modes: state.modes, commands: [...state.commands.values()], contacts: state.contacts, alarms: state.alarms, samples: map.track?.samples ?? [],
    proposal: state.proposal, preview: state.preview,
  });
  facts.time = time;
  rewrite($("timeline-contact"), contactText(facts));
  // While nothing happens it is drawn again when the present has moved on by a pixel.
  if (!changed && before?.heard_s === facts.heard_s && time !== null && drawnAt !== null && Math.abs(toX(facts.now_s) - toX(drawnAt)) < 1) return;
  changed = false;
  shown = lanes(facts);
  rewrite($("timeline-deviation"), deviationText(facts));
  if (follows && span && facts.now_s !== null) moveTo(facts.now_s + .3 * (span[1] - span[0]) - (span[1] - span[0]));
  draw();
  say();
}

const whole = () => {
  const last = Math.max(60, facts?.now_s ?? 0, facts?.heard_s ?? 0, ...shown.flatMap(({ items }) => items.map(({ to, look }) => (look === "ahead" || !Number.isFinite(to) ? 0 : to))));
  return [0, last * AHEAD];
};
const seen = () => span ?? whole();
const names = () => (canvas.clientWidth >= NAMES_FROM ? NAMES : NAMES_SHORT);
const toX = (at) => { const [from, to] = seen(); return names() + ((at - from) / (to - from)) * (canvas.clientWidth - names()); };
const toTime = (x) => { const [from, to] = seen(); return from + ((x - names()) / (canvas.clientWidth - names())) * (to - from); };

// --- drawing --------------------------------------------------------------------------------------------------------

const heightOf = ({ rows }) => rows * ROW + GAP;

function draw() {
  const width = canvas.clientWidth, height = shown.reduce((sum, lane) => sum + heightOf(lane), AXIS), ratio = devicePixelRatio;
  if (!width || !shown.length) return;
  drawnAt = facts.now_s;
  if (canvas.style.height !== `${height}px`) canvas.style.height = `${height}px`;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) { canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio); }
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = "11px system-ui, sans-serif";
  pen.textBaseline = "middle";
  drawAxis(width, height);
  let top = 0;
  for (const lane of shown) { drawLane(lane, top, width); top += heightOf(lane); }
  drawMoments(width, height);
}

function drawAxis(width, height) {
  const [from, to] = seen(), wanted = (to - from) / Math.max(2, (width - names()) / 84);
  const step = STEPS_S.find((each) => each >= wanted) ?? STEPS_S.at(-1);
  pen.fillStyle = colour("--dim");
  pen.strokeStyle = colour("--line");
  pen.lineWidth = 1;
  for (let at = Math.ceil(from / step) * step; at <= to; at += step) {
    const x = Math.round(toX(at)) + .5;
    if (x < names()) continue;
    pen.beginPath(); pen.moveTo(x, 0); pen.lineTo(x, height - AXIS + 3); pen.stroke();
    pen.textAlign = x > width - 24 ? "right" : at === 0 ? "left" : "center";
    pen.fillText(timeLabel(at, step), x, height - AXIS / 2 + 1);
  }
}

function drawLane({ name, rows, items }, top, width) {
  const left = names();
  pen.save();
  pen.beginPath();
  pen.rect(left, top, width - left, rows * ROW + GAP);
  pen.clip();
  const drawn = items.filter(({ tick }) => !tick).map((item) => ({ ...item, ...spanOf(item, width) })).filter(({ x, right }) => right >= left && x <= width);
  for (const item of drawn) drawItem(item, top + GAP / 2 + item.row * ROW);
  for (let row = 0; row < rows; row += 1) drawLabels(drawn.filter((item) => item.row === row), top + GAP / 2 + row * ROW, width);
  const ticks = items.filter(({ tick, from: at }) => tick && toX(at) >= left && toX(at) <= width);
  const radius = Math.min(2.6, Math.max(1.1, (width - left) / (5 * Math.max(1, ticks.length)))); // many samples leave the lane to be seen
  for (const item of ticks) drawTick(item, top + GAP / 2, rows * ROW, radius);
  pen.restore();
  pen.textAlign = "left";
  pen.fillStyle = colour("--dim");
  pen.fillText(name, 0, top + GAP / 2 + (rows * ROW) / 2);
  pen.strokeStyle = colour("--line");
  pen.beginPath(); pen.moveTo(0, top + rows * ROW + GAP + .5); pen.lineTo(width, top + rows * ROW + GAP + .5); pen.stroke();
}

// Where an item lies [px], and where the lines are that mark its stages.
function spanOf({ from, to, stages, row = 0 }, width) {
  const x = Math.max(toX(from), names() - 4), right = Math.max(x + 1.5, Math.min(Number.isFinite(to) ? toX(to) : width + 4, width + 4));
  return { row, x, right, marks: (stages ?? []).map(toX) };
}

function drawItem({ x, right, look, open, marks }, y) {
  const wide = right - x, high = ROW - 2;
  if (look === "unknown") {
    pen.fillStyle = colour("--dim");
    pen.globalAlpha = .3;
    pen.fillRect(x, y, wide, high);
    pen.globalAlpha = 1;
  } else if (look === "planned" || look === "ahead" || look === "proposed") {
    pen.globalAlpha = look === "ahead" ? .35 : 1;
    pen.strokeStyle = colour({ ahead: "--good", proposed: "--preview", planned: "--planned-line" }[look]);
    pen.setLineDash(look === "planned" ? [] : [3, 3]);
    pen.lineWidth = 1.2;
    pen.strokeRect(x + .5, y + .5, Math.max(wide - 1, 1), high - 1);
    pen.setLineDash([]);
    if (look === "ahead") { pen.fillStyle = colour("--good"); pen.globalAlpha = .12; pen.fillRect(x, y, wide, high); }
    pen.globalAlpha = 1;
  } else {
    pen.fillStyle = colour(LOOKS[look] ?? "--dim");
    pen.globalAlpha = look === "dim" ? 1 : .82;
    pen.fillRect(x, y, wide, high);
    pen.globalAlpha = 1;
    if (open) { pen.fillStyle = colour("--text"); pen.fillRect(right - 1.5, y, 1.5, high); }
  }
  pen.fillStyle = colour("--text");
  for (const mark of marks) pen.fillRect(mark - .5, y - 1, 1, high + 2);
}

// The labels of a row: each where no line and no other item crosses it. One that fits nowhere is left to the text and the table.
function drawLabels(items, y, width) {
  const spans = items.map(({ x, right }) => [x, right]), labels = [];
  const lines = items.flatMap(({ x, right, marks }) => [x, right, ...marks].map((at) => [at, at]));
  pen.textAlign = "left";
  items.forEach(({ label, look }, index) => {
    if (!label) return;
    const needs = pen.measureText(label).width + 8, others = spans.filter((_, other) => other !== index && !around(spans[other], spans[index]));
    const place = labelPlace(spans[index], needs, [...lines, ...others, ...labels], [names(), width]);
    if (!place || (!place.within && /^\d+$/.test(label))) return;
    pen.fillStyle = colour(place.within && !["planned", "proposed", "dim"].includes(look) ? "--card" : "--text");
    pen.fillText(label, place.left + 4, y + ROW / 2 - .5);
    labels.push([place.left, place.left + needs]);
  });
}

const around = ([a, b], [from, to]) => a <= from && b >= to; // an item that lies over another one as a whole hides no label of it

function drawTick({ from, tick }, y, high, radius) {
  const x = toX(from);
  pen.fillStyle = colour(LOOKS[tick]);
  if (tick === "sample") { pen.beginPath(); pen.arc(x, y + high / 2 - 1, radius, 0, 7); pen.fill(); return; }
  pen.fillRect(x - 1, y - 2, 2, high + 2);
}

function drawMoments(width, height) {
  const below = height - AXIS;
  const line = (at, style, dash = []) => {
    const x = Math.round(toX(at)) + .5;
    if (at === null || x < names() || x > width) return;
    pen.strokeStyle = style;
    pen.lineWidth = 1.5;
    pen.setLineDash(dash);
    pen.beginPath(); pen.moveTo(x, 0); pen.lineTo(x, below + 3); pen.stroke();
    pen.setLineDash([]);
  };
  const { heard_s, now_s } = facts;
  if (heard_s !== null && now_s !== null) { // what happened since is not known on Earth yet
    pen.fillStyle = colour("--dim");
    pen.globalAlpha = .16;
    pen.fillRect(Math.max(toX(heard_s), names()), 0, Math.max(0, Math.min(toX(now_s), width) - Math.max(toX(heard_s), names())), below);
    pen.globalAlpha = 1;
  }
  line(now_s, colour("--text"));
  if (state.past) line(sinceStart(state.past.mission_time_ns), colour("--warn"));
  line(cursor, colour("--accent"), [4, 3]);
}

// --- in words -------------------------------------------------------------------------------------------------------

function say() {
  const at = cursor ?? facts?.now_s ?? null;
  rewrite($("timeline-says"), at === null || !facts ? "" : `${cursor === null ? "Now" : elapsed(at)}${cursor === null || facts.now_s === null ? "" : ago(at)}: ${described(shown, at - (cursor === null ? 1e-3 : 0))}`);
  if ($("timeline-list").open) list();
}

function ago(at) {
  const since = facts.now_s - at;
  return ` (${since >= 0 ? `${duration(since)} ago` : `in ${duration(-since)}`})`;
}

function list() {
  const [from, to] = seen();
  const rows = shown.flatMap(({ name, items }) => items.filter((item) => item.from <= to && item.to >= from).map((item) => ({ name, ...item }))).sort((a, b) => a.from - b.from).slice(-LISTED);
  $("timeline-rows").replaceChildren(...rows.map(({ name, from: begins, to: ends, text, open, tick }) => element("tr", {},
    element("td", {}, name), element("td", { class: "num" }, elapsed(begins)), element("td", { class: "num" }, tick ? "" : open || !Number.isFinite(ends) ? "open" : elapsed(ends)), element("td", {}, text))));
}
$("timeline-list").addEventListener("toggle", list);

// --- what is seen, and what is pointed at ---------------------------------------------------------------------------

function see(from, to) {
  const [first, last] = whole(), least = Math.max(LEAST_SPAN_S, 1), long = Math.max(least, Math.min(to - from, 4 * last));
  const begin = Math.max(-.1 * last, Math.min(from, 3 * last));
  seeSpan(long >= last - first && begin <= 0 ? null : [begin, begin + long]);
}
const moveTo = (from) => { const [a, b] = seen(); span = [from, from + b - a]; };
function zoom(factor, about = cursor ?? facts?.now_s ?? 0) {
  const [from, to] = seen(), centre = about >= from && about <= to ? about : (from + to) / 2;
  see(centre - (centre - from) * factor, centre + (to - centre) * factor);
}
const pan = (share) => { follows = false; const [from, to] = seen(), by = share * (to - from); see(from + by, to + by); };
const showWhole = () => { follows = false; seeSpan(null); };
function showNow() {
  if (facts?.now_s === null || !facts) return;
  const [from, to] = seen(), long = span ? to - from : Math.min(to - from, 6 * 3600);
  follows = true;
  seeSpan([facts.now_s - .7 * long, facts.now_s + .3 * long]);
}

whenSpanSeen((wanted) => {
  span = wanted;
  $("timeline-whole").setAttribute("aria-pressed", String(span === null));
  $("timeline-now").setAttribute("aria-pressed", String(follows));
  draw();
  say();
  keepView();
});
whenPointedAt((at_s) => {
  cursor = at_s;
  if (!facts) return;
  draw();
  say();
  const place = at_s === null ? null : placeAt(facts, at_s);
  if (String(place) === String(map.pointed)) return;
  map.pointed = place;
  map.draw();
});
whenTimeChanges(() => draw());
whenThemeChanges(() => draw());
new ResizeObserver(() => draw()).observe(canvas);
everyFrame(look);
inAddress("span", () => span?.map((at) => at.toFixed(0)).join(","), (text) => seeSpan(numbers(text, 2)));

// The map, or the recording, at that moment.
function goTo(at_s) {
  const at = state.clock.start_ns + at_s * 1e9;
  if (state.recording) return attempt(() => send("recording", { at_s: Math.max(0, Math.min(state.recording.length_s, (at - state.recording.begin_ns) / 1e9)) }));
  const known = state.revisions.filter(({ mission_time_ns }) => mission_time_ns <= at);
  showMoment(known.length === state.revisions.length ? null : known.at(-1) ?? state.revisions[0] ?? null);
}

$("timeline-in").addEventListener("click", () => zoom(.5));
$("timeline-out").addEventListener("click", () => zoom(2));
$("timeline-whole").addEventListener("click", showWhole);
$("timeline-now").addEventListener("click", showNow);

const STEPS = { ArrowLeft: -1, ArrowRight: 1 };
canvas.addEventListener("keydown", (event) => {
  if (!facts) return;
  const [from, to] = seen(), at = cursor ?? facts.now_s ?? to, step = STEPS[event.key];
  if (step && (event.ctrlKey || event.metaKey)) pan(step * .25);
  else if (step) pointAt(Math.max(from, Math.min(to, at + step * (to - from) * (event.shiftKey ? .05 : .005))), canvas);
  else if (event.key === "+" || event.key === "=") zoom(.5, at);
  else if (event.key === "-") zoom(2, at);
  else if (event.key === "0") showWhole();
  else if (event.key === "End") showNow();
  else if (event.key === "Home") { follows = false; see(0, to - from); }
  else if (event.key === "n" || event.key === "N") point(edges(shown).find((each) => each > at + 1e-6));
  else if (event.key === "p" || event.key === "P") point(edges(shown).findLast((each) => each < at - 1e-6));
  else if (event.key === "Enter") goTo(at);
  else if (event.key === "Escape") pointAt(null, canvas);
  else return;
  event.preventDefault();
});

// Points at a moment, and brings it into sight.
function point(at) {
  if (at === undefined) return;
  const [from, to] = seen();
  if (at < from || at > to) { follows = false; see(at - (to - from) / 2, at + (to - from) / 2); }
  pointAt(at, canvas);
}

const touches = new Map(); // pointers that are down, and where they are
let dragged = null;        // { x, seen } where the drag began
canvas.addEventListener("pointerdown", (event) => {
  touches.set(event.pointerId, event.offsetX);
  dragged = { x: event.offsetX, seen: seen(), moved: false, apart: apart() };
});
canvas.addEventListener("pointermove", (event) => {
  if (touches.has(event.pointerId)) touches.set(event.pointerId, event.offsetX);
  if (dragged && touches.size === 2) {
    const [from, to] = dragged.seen, factor = Math.min(20, Math.max(.05, dragged.apart / Math.max(apart(), 1))), centre = (from + to) / 2;
    dragged.moved = true;
    see(centre - ((to - from) / 2) * factor, centre + ((to - from) / 2) * factor);
  } else if (dragged && touches.size === 1) {
    const by = dragged.x - event.offsetX;
    if (!dragged.moved && Math.abs(by) < DRAG_PX) return;
    if (!dragged.moved) canvas.setPointerCapture(event.pointerId);
    dragged.moved = true;
    follows = false;
    const [from, to] = dragged.seen, seconds = (by / (canvas.clientWidth - names())) * (to - from);
    see(from + seconds, to + seconds);
  } else if (event.offsetX >= names()) pointAt(toTime(event.offsetX), canvas);
});
const apart = () => { const [a, b] = [...touches.values()]; return b === undefined ? 0 : Math.abs(a - b); };
for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, (event) => {
  touches.delete(event.pointerId);
  if (dragged && !dragged.moved && kind === "pointerup" && event.offsetX >= names()) pointAt(toTime(event.offsetX), canvas);
  if (!touches.size) dragged = null;
});
canvas.addEventListener("pointerleave", (event) => { if (event.pointerType === "mouse" && document.activeElement !== canvas) pointAt(null, canvas); });
canvas.addEventListener("dblclick", (event) => goTo(toTime(event.offsetX)));
canvas.addEventListener("wheel", (event) => {
  event.preventDefault();
  if (Math.abs(event.deltaX) > Math.abs(event.deltaY) || event.shiftKey) pan(Math.sign(event.deltaX || event.deltaY) * .1);
  else zoom(event.deltaY > 0 ? 1.25 : .8, toTime(event.offsetX));
}, { passive: false });
