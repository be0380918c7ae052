// What is drawn on a layer: paths, samples, areas, the rover, the cross-hair, a measured line, axes and the scale bar.
// Each function takes the context, the projection, and what it draws; `colour` gives a colour of the page by its name.

import { nice, tenth } from "./projection.js";

const TICKS_APART_PX = 80; // at least
const LABEL_FONT = "600 11px system-ui, sans-serif";
const NAME_PX = 110; // of the name of an area

export function axes(context, projection, colour) {
  const { left, right, top, bottom } = projection.box, { west, south, east, north } = projection.window;
  context.strokeStyle = colour("--line");
  context.fillStyle = colour("--dim");
  context.font = "11px system-ui, sans-serif";
  context.lineWidth = 1;
  context.strokeRect(left - .5, top - .5, right - left + 1, bottom - top + 1);
  const step = nice(TICKS_APART_PX / projection.scale), digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const ticks = (low, high) => Array.from({ length: Math.floor(high / step + 1e-6) - Math.ceil(low / step - 1e-6) + 1 }, (_, index) => (Math.ceil(low / step - 1e-6) + index) * step);
  for (const value of ticks(west, east)) {
    const [x] = projection.at(value, 0), text = `${value.toFixed(digits)}${value === 0 ? " m" : ""}`, half = context.measureText(text).width / 2;
    context.textAlign = x - half < left ? "left" : x + half > right ? "right" : "center";
    context.fillText(text, x, bottom + 15);
  }
  context.textAlign = "right";
  for (const value of ticks(south, north)) {
    const [, y] = projection.at(0, value);
    if (y < bottom - 16) context.fillText(value.toFixed(digits), left - 6, Math.max(y + 4, top + 8));
  }
  context.fillText("N↑", left - 6, bottom - 2);
}

export function scaleBar(context, projection) {
  const { left, right, bottom } = projection.box, metres = lengthWithin((right - left) * .28 / projection.scale), pixels = metres * projection.scale;
  const [x, y] = [right - pixels - 12, bottom - 12], text = metres >= 1000 ? `${metres / 1000} km` : `${metres} m`;
  context.font = "600 11px system-ui, sans-serif";
  context.textAlign = "center";
  context.fillStyle = "rgb(0 0 0 / 60%)";
  context.fillRect(x - 6, y - 16, pixels + 12, 23);
  context.strokeStyle = context.fillStyle = "#fff";
  context.lineWidth = 1.6;
  context.beginPath();
  context.moveTo(x, y - 3); context.lineTo(x, y + 2); context.lineTo(x + pixels, y + 2); context.lineTo(x + pixels, y - 3);
  context.stroke();
  context.fillText(text, x + pixels / 2, y - 4);
}

function lengthWithin(metres) {
  const power = 10 ** Math.floor(Math.log10(metres)), factor = [5, 2, 1].find((each) => each * power <= metres);
  return Number((factor * power).toPrecision(1));
}

export function line(context, projection, points, width, style, dash = []) {
  if (points.length < 2) return;
  context.beginPath();
  points.forEach(([x, y], index) => { const place = projection.at(x, y); index ? context.lineTo(...place) : context.moveTo(...place); });
  context.setLineDash(dash);
  context.lineWidth = width;
  context.strokeStyle = style;
  context.lineJoin = "round";
  context.stroke();
  context.setLineDash([]);
}

export function paths(context, projection, colour, { driven_path_m, planned_path_m }) {
  line(context, projection, driven_path_m, 3.2, "rgb(0 0 0 / 55%)");
  line(context, projection, driven_path_m, 1.6, colour("--driven"));
  line(context, projection, planned_path_m, 3.4, "rgb(0 0 0 / 60%)", [7, 5]);
  line(context, projection, planned_path_m, 1.9, colour("--planned"), [7, 5]);
}

export function samples(context, projection, colour, taken, selected) {
  for (const { sample_id, x_m, y_m } of taken) {
    const [x, y] = projection.at(x_m, y_m);
    circle(context, x, y, 3.6, colour("--sample"), "#fff", 1.4);
    circle(context, x, y, 4.6, null, "rgb(0 0 0 / 70%)", .8);
    if (sample_id !== selected) continue;
    circle(context, x, y, 9, null, "rgb(0 0 0 / 70%)", 4.4);
    circle(context, x, y, 9, null, colour("--planned"), 2.4);
  }
}

function circle(context, x, y, radius, fill, stroke, width) {
  context.beginPath();
  context.arc(x, y, radius, 0, 7);
  if (fill) { context.fillStyle = fill; context.fill(); }
  context.lineWidth = width;
  context.strokeStyle = stroke;
  context.stroke();
}

export function undecided(context, projection, colour, path) {
  line(context, projection, path, 4.6, "rgb(0 0 0 / 70%)");
  line(context, projection, path, 2.6, colour("--preview"), [3, 4]);
}

// The tracks of all flights of a rehearsal: the more of them go one way, the denser it is.
export function rehearsed(context, projection, colour, forecasts) {
  context.save();
  for (const [index, { tracks, colour: name }] of forecasts.entries()) {
    context.globalAlpha = Math.min(.8, Math.max(.12, 4 / tracks.length));
    for (const track of tracks) line(context, projection, track, 1.6, colour(name), index ? [5, 3] : []);
  }
  context.restore();
}

// The plan that waits: its way, straight and thin while the ground has not found it, and its numbered stops.
export function proposed(context, projection, colour, { path, checked, samples: stops, selected, editable }) {
  if (checked) undecided(context, projection, colour, path);
  else {
    line(context, projection, path, 4, "rgb(0 0 0 / 60%)", [3, 6]);
    line(context, projection, path, 2.2, colour("--preview"), [3, 6]);
  }
  const half = editable ? 8 : 4.5;
  stops.forEach(({ x_m, y_m, taken }, index) => {
    const [x, y] = projection.at(x_m, y_m);
    context.fillStyle = taken ? colour("--preview") : "rgb(0 0 0 / 70%)";
    context.strokeStyle = taken ? "#000" : colour("--preview");
    context.lineWidth = 1.4;
    context.fillRect(x - half, y - half, 2 * half, 2 * half);
    context.strokeRect(x - half, y - half, 2 * half, 2 * half);
    if (index === selected) {
      context.strokeStyle = "#fff";
      context.lineWidth = 2.2;
      context.strokeRect(x - half - 3, y - half - 3, 2 * half + 6, 2 * half + 6);
    }
    if (!editable) return;
    context.fillStyle = taken ? "#000" : colour("--preview");
    context.font = "700 11px system-ui, sans-serif";
    context.textAlign = "center";
    context.fillText(`${index + 1}`, x, y + 4);
  });
}

export function area(context, projection, colour, { corners, kind, selected }) {
  const keepOut = kind === "keepout", style = colour(keepOut ? "--keepout" : "--interest"), closed = [...corners, corners[0]];
  line(context, projection, closed, selected ? 6 : 3.6, selected ? colour("--planned") : "rgb(0 0 0 / 55%)");
  line(context, projection, closed, 2.1, style, keepOut ? [] : [6, 4]);
  if (keepOut) hatched(context, projection, corners, style);
}

// Its name, which lies over paths and samples; a long one ends with … unless the area is selected. The note follows it.
export function areaName(context, projection, colour, { corners, kind, name, note = "", selected }) {
  if (!name) return;
  context.font = LABEL_FONT;
  const measure = (text) => context.measureText(text).width, { left, right } = projection.box;
  const text = (selected ? name : shortened(name, NAME_PX - measure(note), measure)) + note;
  const [x, y] = projection.at(...corners[0]), seen = x >= left && x <= right;
  label(context, text, [seen ? Math.max(left + 2, Math.min(x, right - measure(text) - 8)) : x, y], colour(kind === "keepout" ? "--keepout" : "--interest"));
}

// The text if it is no wider; else its longest beginning that is with an ellipsis, of one character at least.
export function shortened(text, width, measure) {
  if (measure(text) <= width) return text;
  const characters = [...text];
  while (characters.length > 1 && measure(`${characters.join("")}…`) > width) characters.pop();
  return `${characters.join("")}…`;
}

function hatched(context, projection, corners, style) {
  const places = corners.map((corner) => projection.at(...corner)), { left, right, top, bottom } = projection.box;
  const low = Math.max(left, Math.min(...places.map((p) => p[0]))), high = Math.min(right, Math.max(...places.map((p) => p[0])));
  const above = Math.max(top, Math.min(...places.map((p) => p[1]))), below = Math.min(bottom, Math.max(...places.map((p) => p[1])));
  if (low >= high || above >= below) return;
  context.save();
  context.beginPath();
  places.forEach((place, index) => (index ? context.lineTo(...place) : context.moveTo(...place)));
  context.clip();
  context.strokeStyle = style;
  context.globalAlpha = .55;
  context.lineWidth = 1.2;
  context.beginPath();
  for (let x = low - (below - above); x < high; x += 9) { context.moveTo(x, below); context.lineTo(x + below - above, above); }
  context.stroke();
  context.restore();
}

export function corners(context, projection, places, style) {
  line(context, projection, places, 4, "rgb(0 0 0 / 60%)");
  line(context, projection, places, 2, style);
  for (const place of places) circle(context, ...projection.at(...place), 4.5, style, "#000", 1);
}

// A measured line, with its length so far at each of its corners.
export function measured(context, projection, places, style) {
  corners(context, projection, places, style);
  let sum = 0;
  places.forEach((place, index) => {
    if (!index) return;
    sum += Math.hypot(place[0] - places[index - 1][0], place[1] - places[index - 1][1]);
    const [x, y] = projection.at(...place);
    label(context, `${tenth(sum)} m`, [x + 6, y], "#fff");
  });
}

export function target(context, projection, place, style, full = false) {
  const [x, y] = projection.at(...place);
  for (const [width, stroke] of [[3.4, "rgb(0 0 0 / 65%)"], [1.5, style]]) {
    context.lineWidth = width;
    context.strokeStyle = stroke;
    context.beginPath();
    if (!full) context.arc(x, y, 8, 0, 7);
    const reach = full ? 5000 : 14, gap = full ? 6 : 4;
    for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) { context.moveTo(x + dx * gap, y + dy * gap); context.lineTo(x + dx * reach, y + dy * reach); }
    context.stroke();
  }
}

export function vehicle(context, projection, colour, rover) {
  context.save();
  context.translate(...projection.at(rover.x_m, rover.y_m));
  if (rover.stale) context.setLineDash([4, 3]);
  circle(context, 0, 0, 13, "rgb(0 0 0 / 35%)", rover.stale ? colour("--bad") : "rgb(255 255 255 / 85%)", 1.5);
  context.setLineDash([]);
  context.rotate((rover.heading_deg * Math.PI) / 180);
  context.beginPath();
  context.moveTo(0, -10);
  context.lineTo(7, 8);
  context.lineTo(0, 4.5);
  context.lineTo(-7, 8);
  context.closePath();
  context.fillStyle = rover.stale ? colour("--bad") : "#5cc8d7";
  context.fill();
  context.strokeStyle = "#001";
  context.lineWidth = 1.2;
  context.stroke();
  context.restore();
}

export function label(context, text, [x, y], style) {
  context.font = LABEL_FONT;
  context.textAlign = "left";
  const width = context.measureText(text).width;
  context.fillStyle = "rgb(0 0 0 / 70%)";
  context.fillRect(x - 2, y - 17, width + 8, 15);
  context.fillStyle = style;
  context.fillText(text, x + 2, y - 6);
}
