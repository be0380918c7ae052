// The rehearsal: the rest of the mission flown ahead on the server, as planned and, if wanted, against an alternative.

import { map } from "./layers.js";
import { askJson, send } from "./net.js";
import { $, numberIn, rewrite, sinceStart, state } from "./state.js";
import { line, node, text } from "./svg.js";
import { duration, elapsed, element, fixed, grouped } from "./words.js";

const LOOK_EVERY_MS = 500;
const COLOURS = ["--accent", "--preview"]; // as planned, and the alternative
const SHOWN = {
  lasts_s: ["Ends in", (value) => (value < 60 ? `${Math.round(value)} s` : duration(value))], driven_m: ["Drives", (value) => `${grouped(value)} m`],
  samples: ["Samples", (value) => grouped(value)], mean_std_ppb: ["Mean std at the end", (value) => `${fixed(value, value < 1 ? 3 : value < 10 ? 2 : 1)} ppb`],
  charge_wh: ["Battery at the end", (value) => `${grouped(value)} Wh`], lowest_wh: ["Battery, lowest", (value) => `${grouped(value)} Wh`],
};
const WIDE = 420, LEFT = 40, RIGHT = 12;

let shown = 0;       // the number of the rehearsal whose result is shown; 0 for none
let underWay = 0;    // the number of the rehearsal that was under way when the server was asked last; 0 for none
let looking = null;
let refused = "";    // why the rehearsal that was wanted here last has not begun, or is there no more
let sending = 0;     // requests to begin or to stop one that are not answered yet
let sent = 0;        // how many such requests there were

// --- what is rehearsed ------------------------------------------------------------------------------------------------

const choice = $("rehearsal-against"), said = $("rehearsal-words");

// The alternative in words; null for none. Throws if the map does not have what it is about.
function against() {
  switch (choice.value) {
    case "": return null;
    case "words":
      if (said.value.trim() === "") { said.focus(); throw new Error("in words: expected an alternative such as go-to 120 340, got nothing"); }
      return said.value.trim();
    case "go-to":
      if (!map.chosen) throw new Error("go to the place: expected a place that is chosen on the map, got none");
      return `go-to ${map.chosen.map((value) => value.toFixed(2)).join(" ")}`;
    case "keep-out":
      if (map.draft.length < 3) throw new Error(`keep out of the area: expected a drawn area of at least 3 corners, got ${map.draft.length}`);
      return `keep-out ${areaName()} ${map.draft.map((corner) => corner.map((value) => value.toFixed(2)).join(",")).join(" ")}`;
    default: return choice.value;
  }
}

const areaName = () => ($("area-name").validity.valid && $("area-name").value) || "rehearsed";

choice.addEventListener("focus", () => {
  for (const option of choice.options) option.disabled = option.value === `planner ${state.status?.planner}`;
});
choice.addEventListener("change", () => { $("rehearsal-words-field").hidden = choice.value !== "words"; });

$("rehearsal-form").addEventListener("submit", (event) => {
  event.preventDefault();
  refused = "";
  tried(async () => follow(await send("rehearsal", { draws: numberIn($("rehearsal-draws")), against: against() })));
});
$("rehearsal-stop").addEventListener("click", () => tried(async () => follow(await send("rehearsal/stop", { number: underWay }))));

async function tried(what) {
  sending += 1;
  sent += 1;
  try { await what(); } catch (error) {
    refused = error.message;
    rewrite($("rehearsal-failure"), refused);
    lookAtRehearsal(); // another browser's may be under way
  } finally { sending -= 1; }
}

// --- its progress -----------------------------------------------------------------------------------------------------

// Asks now, and from then on as long as one is under way.
export function lookAtRehearsal() {
  lookIn(0);
}

function lookIn(wait_ms) {
  clearTimeout(looking);
  looking = setTimeout(look, wait_ms);
}

function look() {
  looking = null;
  const before = sent;
  askJson("rehearsal", { known: shown }).then((told) => {
    if (sending || sent !== before) lookIn(LOOK_EVERY_MS); // it may be older than what was sent since
    else follow(told);
  }).catch(() => lookIn(4 * LOOK_EVERY_MS));
}

function follow({ number, running, done, of: flights, by, may_stop: mayStop, why, result }) {
  $("rehearsal-stop").hidden = !mayStop;
  $("rehearsal-start").disabled = running;
  const bar = $("rehearsal-progress");
  bar.hidden = !running;
  if (running) { bar.max = flights; bar.value = done; }
  rewrite($("rehearsal-note"), running ? `${done ? `${done} of ${flights}` : "begins …"}, begun by ${by}` : "");
  if (underWay && number !== underWay) { // no two have one number, whatever happens to the server
    refused = number ? "Another rehearsal was begun after the one that was under way" : "The rehearsal has ended with the page's server, which was started anew";
  } else if (result) refused = "";
  rewrite($("rehearsal-failure"), refused || why || "");
  underWay = running ? number : 0;
  if (result) { shown = number; draw(result, by); }
  if (running) lookIn(LOOK_EVERY_MS);
}

// --- its result -------------------------------------------------------------------------------------------------------

function draw(result, by) {
  const { forecasts } = result;
  $("rehearsal-result").hidden = false;
  $("rehearsal-said").replaceChildren(
    element("p", { class: "dim num" }, `From ${elapsed(sinceStart(result.at))}, begun by ${by}; flights: ${result.drawn}`),
    ...result.assumptions.map((each) => element("p", {}, `Taken for granted: ${each}`)),
    ...forecasts.filter(({ not_done: failed }) => failed).map(({ name, not_done: failed }) => element("p", { class: "failed" }, `Not done, ${name}: ${failed}`)));
  $("rehearsal-table").replaceChildren(...table(result));
  $("rehearsal-charts").replaceChildren(...[ends(forecasts), charges(forecasts)].filter(Boolean));
  $("rehearsal-rounds").replaceChildren(...rounds(forecasts));
  onMap();
  map.rehearsed = forecasts.map(({ tracks_m: tracks }, index) => ({ tracks, colour: COLOURS[index] }));
  map.draw();
}

function table({ forecasts, more }) {
  const columns = [...forecasts.map(({ name }, index) => element("span", {}, key(index), ` ${name}`)), ...(forecasts.length > 1 ? ["Difference"] : [])];
  const head = element("thead", {}, element("tr", {}, element("td"), ...columns.map((each) => element("th", { scope: "col" }, each))));
  const rows = Object.entries(SHOWN).map(([figure, [name, said]]) => {
    const cells = forecasts.map(({ bands }) => cell(bands[figure], said));
    if (forecasts.length > 1) cells.push(cell(more[figure], signed(said)));
    return element("tr", {}, element("th", { scope: "row" }, name, strip(forecasts.map(({ bands }) => bands[figure]), said)), ...cells);
  });
  return [element("caption", { class: "sr" }, "What is to be expected at the end of the mission: medians, and bands of 95 per cent"), head, element("tbody", {}, ...rows)];
}

// The text of a difference: with its sign, unless it is as good as none.
const signed = (said) => (value) => {
  const size = said(Math.abs(value));
  return size === said(0) ? size : `${value < 0 ? "−" : "+"}${size}`;
};

function cell({ median, low_95: low, high_95: high }, said) {
  const content = [element("b", {}, said(median))];
  if (said(low) !== said(high)) content.push(element("span", { class: "dim" }, `95 %: ${span(said(low), said(high))}`));
  return element("td", {}, ...content);
}

// From one value to another; a unit that both have is said once.
function span(low, high) {
  const unit = /^[^ ]+( [a-z]+)$/i.exec(high)?.[1];
  return `${unit && /^[^ ]+ [a-z]+$/i.test(low) && low.endsWith(unit) ? low.slice(0, -unit.length) : low} to ${high}`;
}

// A sign of which forecast is meant that does not need its colour.
function key(index) {
  const made = node("svg", { viewBox: "0 0 22 10", class: "key", "aria-hidden": "true" });
  made.append(bar(1, 21, 5, 1.5, index), bar(5, 17, 5, 6, index));
  return made;
}

function bar(from, to, y, height, index) {
  const colour = `var(${COLOURS[index]})`;
  return node("rect", { x: Math.min(from, to), y: y - height / 2, width: Math.max(Math.abs(to - from), 1.2), height, fill: index && height > 2 ? "var(--card)" : colour, stroke: colour, "stroke-width": index && height > 2 ? 1.2 : 0 });
}

function band(made, { median, low_68: low, high_68: high, low_95: least, high_95: most }, at, y, index) {
  made.append(bar(at(least), at(most), y, 1.6, index), bar(at(low), at(high), y, 6, index), node("circle", { cx: at(median), cy: y, r: 2, fill: "var(--text)" }));
}

// The bands of one figure on an axis of their own.
function strip(bands, said) {
  if (bands.every((each) => said(each.low_95) === said(bands[0].low_95) && said(each.high_95) === said(bands[0].low_95))) return "";
  const low = Math.min(...bands.map((each) => each.low_95)), high = Math.max(...bands.map((each) => each.high_95));
  if (!(high > low)) return "";
  const made = node("svg", { viewBox: `0 0 120 ${bands.length * 9 + 2}`, class: "strip", "aria-hidden": "true" });
  bands.forEach((each, index) => band(made, each, (value) => 3 + (114 * (value - low)) / (high - low), 6 + 9 * index, index));
  return made;
}

function figure(title, made) {
  return element("figure", {}, element("figcaption", { class: "dim" }, title), made);
}

const hours = (value) => `${Number((value / 3600).toPrecision(3))} h`;

function axis(made, most_s, bottom, at) {
  const step = 3600 * ([1, 2, 5, 10, 20, 50, 100, 200, 500].find((each) => most_s / 3600 / each <= 6) ?? 1000);
  for (let value = 0; value <= most_s; value += step) {
    made.append(line(at(value), 4, at(value), bottom, "var(--line)"), text(at(value), bottom + 13, hours(value), value ? "middle" : "start"));
  }
}

// When each round is done, against its median as planned: the bands are minutes where the rounds are hours.
function ends(forecasts) {
  const numbers = roundsOf(forecasts);
  if (!numbers.length) return null;
  const usual = Object.fromEntries(numbers.map((number) => [number, forecasts.find(({ rounds_s: each }) => each[number]).rounds_s[number].median]));
  const row = Math.min(22, Math.max(8 * forecasts.length, 240 / numbers.length)), bottom = 6 + row * numbers.length, left = 96;
  const off = forecasts.flatMap(({ rounds_s: each }) => Object.entries(each).flatMap(([number, { low_95: low, high_95: high }]) => [low - usual[number], high - usual[number]]));
  const low = Math.min(...off, -60), high = Math.max(...off, 60), at = (value) => left + ((WIDE - left - RIGHT) * (value - low)) / (high - low);
  const last = numbers.at(-1), said = forecasts.filter(({ rounds_s: each }) => each[last]).map(({ name, rounds_s: each }) => `${name} in ${duration(each[last].median)}, 95 %: ${span(duration(each[last].low_95), duration(each[last].high_95))}`);
  const made = node("svg", { viewBox: `0 0 ${WIDE} ${bottom + 18}`, role: "img", "aria-label": `When the rounds are done, against the median as planned. Round ${last}: ${said.join("; ")}` });
  const step = [60, 120, 300, 600, 1200, 1800, 3600, 7200, 18000, 36000, 72000, 180000].find((each) => (high - low) / each <= 6) ?? 360000;
  for (let value = Math.ceil(low / step) * step; value <= high; value += step) {
    made.append(line(at(value), 4, at(value), bottom, value ? "var(--line)" : "var(--dim)"), text(at(value), bottom + 13, value ? `${value < 0 ? "−" : "+"}${step < 3600 ? `${Math.abs(value) / 60} min` : `${Math.abs(value) / 3600} h`}` : "0", "middle"));
  }
  const every = Math.ceil(12 / row);
  numbers.forEach((number, index) => {
    const y = 6 + row * (index + .5);
    if (index % every === 0) made.append(text(left - 8, y + 3.5, `${number} · ${duration(usual[number])}`, "end"));
    forecasts.forEach(({ rounds_s: each }, which) => {
      if (each[number]) band(made, each[number], (value) => at(value - usual[number]), y + (which - (forecasts.length - 1) / 2) * (row / 2.2), which);
    });
  });
  return figure("Rounds done in, and how much earlier or later with 68 % (wide) and 95 % (thin)", made);
}

const roundsOf = (forecasts) => [...new Set(forecasts.flatMap(({ rounds_s: each }) => Object.keys(each).map(Number)))].sort((a, b) => a - b);

// The battery's charge over time.
function charges(forecasts) {
  const curves = forecasts.map(({ charges_wh: each }) => each);
  if (!curves.every((each) => each.length)) return null;
  const most_s = Math.max(...curves.map((each) => each.at(-1).at_s)), most = Math.max(...curves.flat().map(({ high_95: high }) => high));
  const high = 96, at = (value) => LEFT + ((WIDE - LEFT - RIGHT) * value) / most_s, y = (value) => high - ((high - 6) * Math.max(0, value)) / most;
  const said = forecasts.map(({ name, bands: { charge_wh: end, lowest_wh: lowest } }) => `${name}: ${grouped(end.median)} Wh at the end, ${grouped(lowest.median)} Wh at the lowest`);
  const made = node("svg", { viewBox: `0 0 ${WIDE} ${high + 18}`, role: "img", "aria-label": `Charge of the battery, from now. ${said.join("; ")}` });
  axis(made, most_s, high, at);
  for (const value of [0, most]) made.append(text(LEFT - 6, y(value) + (value ? 8 : 0), grouped(value), "end"));
  curves.forEach((curve, index) => {
    const path = (name) => curve.map((each) => `${at(each.at_s).toFixed(1)},${y(each[name]).toFixed(1)}`);
    for (const [low, up, opacity] of [["low_95", "high_95", .16], ["low_68", "high_68", .3]]) {
      made.append(node("polygon", { points: [...path(up), ...path(low).reverse()].join(" "), fill: `var(${COLOURS[index]})`, opacity }));
    }
    made.append(node("polyline", { points: path("median").join(" "), fill: "none", stroke: `var(${COLOURS[index]})`, "stroke-width": 1.6, "stroke-dasharray": index ? "5 3" : "none" }));
  });
  return figure("Battery [Wh], from now", made);
}

function rounds(forecasts) {
  const numbers = roundsOf(forecasts);
  const head = element("thead", {}, element("tr", {}, element("th", { scope: "col" }, "Round"), ...forecasts.map(({ name }) => element("th", { scope: "col" }, name))));
  return [head, element("tbody", {}, ...numbers.map((number) => element("tr", {}, element("th", { scope: "row" }, String(number)),
    ...forecasts.map(({ rounds_s: each }) => (each[number] ? cell(each[number], duration) : element("td", {}, "not in every flight"))))))];
}

function onMap() {
  map.show.rehearsed = $("rehearsal-on-map").checked;
  map.draw();
}
$("rehearsal-on-map").addEventListener("change", onMap);
