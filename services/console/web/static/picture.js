// "Export PNG": the map as it is seen, with title, legend, scale, and where it comes from.

import { map, ramp, scaleTexts } from "./layers.js";
import { $, attempt, sinceStart, state } from "./state.js";
import { elapsed, utc } from "./words.js";

const RATIO = 2, EDGE = 16, LINE = 17, FOOT = 11;
const MARKS = [["●", "--sample", "sample"], ["━", "--driven", "driven path"], ["╍", "--planned", "planned path"], ["▲", "--accent", "rover, last known"], ["▨", "--keepout", "keep-out"], ["▢", "--interest", "interest"]];

export function picture() {
  if (!map.panes.length) throw new Error("map: there is none yet; export it when it is shown");
  const style = getComputedStyle(document.documentElement), colour = (name) => style.getPropertyValue(name).trim();
  const [width, height] = map.projection.size, { about } = map.panes[0], provenance = wrapped($("provenance").textContent || "the region gives no account of its data", width);
  const head = 2 * LINE + 14, legend = map.panes.length * 36 + LINE + 8, foot = (provenance.length + 1) * (FOOT + 4) + 8;
  const canvas = document.createElement("canvas");
  canvas.width = (width + 2 * EDGE) * RATIO;
  canvas.height = (head + height + legend + foot + 2 * EDGE) * RATIO;
  const context = canvas.getContext("2d");
  context.scale(RATIO, RATIO);
  context.fillStyle = colour("--card");
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.translate(EDGE, EDGE);
  const write = (text, x, y, font, paint, align = "left") => { context.font = font; context.fillStyle = paint; context.textAlign = align; context.fillText(text, x, y); };
  const at = about.mission_time_ns;
  write(map.panes.map((shown) => capital(scaleTexts(shown)[1])).join("  |  "), 0, 15, "600 16px system-ui, sans-serif", colour("--text"));
  write(`${$("mission").textContent} · revision ${about.revision} · ${about.samples} samples · ${elapsed(sinceStart(at))} · ${utc(at)} UTC`, 0, 15 + LINE, "12px system-ui, sans-serif", colour("--dim"));
  context.save();
  context.translate(0, head);
  map.paint(context, RATIO);
  context.restore();
  let y = head + height + 8;
  for (const shown of map.panes) {
    const strip = document.createElement("canvas");
    strip.height = 10;
    ramp(strip, shown.stops);
    context.drawImage(strip, 42, y, width - 54, 10);
    const texts = scaleTexts(shown), places = [[42, "left"], [42 + (width - 54) / 2, "center"], [width - 12, "right"]];
    texts.forEach((text, index) => write(text, places[index][0], y + 24, "12px system-ui, sans-serif", colour("--text"), places[index][1]));
    y += 36;
  }
  let x = 42;
  for (const [sign, paint, name] of MARKS) {
    write(sign, x, y + 6, "13px system-ui, sans-serif", paint === "--driven" ? colour("--dim") : colour(paint));
    write(name, x + 17, y + 6, "11px system-ui, sans-serif", colour("--dim"));
    x += 30 + context.measureText(name).width;
  }
  y += LINE + 8;
  for (const text of [...provenance, `${map.relief ? "Relief shading: light from the north-west, 45° high. " : ""}Made with he3, ${new Date().toISOString().slice(0, 19)}Z`]) {
    write(text, 0, y + FOOT, `${FOOT}px system-ui, sans-serif`, colour("--dim"));
    y += FOOT + 4;
  }
  return canvas;
}

const capital = (text) => text[0].toUpperCase() + text.slice(1);

function wrapped(text, width) {
  const context = document.createElement("canvas").getContext("2d"), lines = [""];
  context.font = `${FOOT}px system-ui, sans-serif`;
  for (const word of text.split(/\s+/)) {
    const longer = lines.at(-1) === "" ? word : `${lines.at(-1)} ${word}`;
    if (context.measureText(longer).width <= width) lines[lines.length - 1] = longer; else lines.push(word);
  }
  return lines;
}

const named = () => {
  const [{ source, about }] = map.panes;
  return `${$("mission").textContent}-${source.layer}-${about.revision}.png`.replaceAll(/[^\w.-]+/g, "_");
};

$("picture").addEventListener("click", () => attempt(async () => {
  if (map.projection.size) await map.loaded(map.panes.map(({ source }) => source));
  const canvas = picture(), blob = await new Promise((resolve) => canvas.toBlob(resolve, "image/png"));
  const link = document.createElement("a");
  link.download = named();
  link.href = URL.createObjectURL(blob);
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
  $("picture").dataset.made = JSON.stringify({ name: link.download, width: canvas.width, height: canvas.height, bytes: blob.size });
}));
