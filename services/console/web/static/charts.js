// Small line charts over mission hours.

import { nice } from "./map.js";
import { line, node, text } from "./svg.js";

const HEIGHT = 110, LEFT = 38, RIGHT = 8, TOP = 8, BOTTOM = 20;

export class Chart {
  constructor(figure, digits, fromZero = false, step = false) {
    this.svg = figure.querySelector("svg");
    this.value = figure.querySelector("b");
    this.digits = digits;
    this.fromZero = fromZero;
    this.step = step;
    this.points = [];
    this.mark = null;
    new ResizeObserver(() => this.draw()).observe(this.svg);
  }

  set(points) { this.points = points; this.draw(); }

  // A moment to mark [s since the mission's start]; null for none.
  setMark(at) { this.mark = at; this.draw(); }

  // New points replace the tail that they overlap.
  extend(points) {
    if (!points.length) return;
    const first = points[0][0];
    this.points = [...this.points.filter(([at]) => at < first), ...points];
    this.draw();
  }

  draw() {
    const width = this.svg.clientWidth;
    const { points } = this;
    if (!width) return;
    this.svg.setAttribute("viewBox", `0 0 ${width} ${HEIGHT}`);
    if (!points.length) { this.svg.replaceChildren(text(width / 2, HEIGHT / 2, "no data yet", "middle")); this.value.textContent = "–"; return; }
    this.value.textContent = points.at(-1)[1].toLocaleString("en", { minimumFractionDigits: this.digits, maximumFractionDigits: this.digits });
    const end = Math.max(points.at(-1)[0], 1);
    let low = this.fromZero ? 0 : Math.min(...points.map((p) => p[1])), high = Math.max(...points.map((p) => p[1]));
    if (high - low < 1e-9) { high = low + (Math.abs(low) || 1) * .5; if (!this.fromZero) low -= (Math.abs(low) || 1) * .1; }
    if (this.step) high = Math.max(high, 3);
    const step = nice((high - low) / 3);
    low = Math.floor(low / step) * step;
    high = Math.ceil(high / step - 1e-9) * step;
    const x = (at) => LEFT + (at / end) * (width - LEFT - RIGHT), y = (value) => HEIGHT - BOTTOM - ((value - low) / (high - low)) * (HEIGHT - TOP - BOTTOM);
    const parts = [];
    for (let value = low; value <= high + step / 2; value += step) {
      parts.push(line(LEFT, y(value), width - RIGHT, y(value), "var(--line)"), text(LEFT - 5, y(value) + 3.5, Number(value.toPrecision(6)).toLocaleString("en"), "end"));
    }
    const hours = end / 3600, tick = nice(hours / (width < 240 ? 2.5 : 4));
    for (let hour = 0; hour <= hours; hour += tick) parts.push(text(x(hour * 3600), HEIGHT - 6, hour === 0 ? "0 h" : Number(hour.toPrecision(4)), hour === 0 ? "start" : "middle"));
    let path = "";
    points.forEach(([at, value], index) => { path += index === 0 ? `M${x(at)} ${y(value)}` : this.step ? `H${x(at)}V${y(value)}` : `L${x(at)} ${y(value)}`; });
    const curve = node("path", { d: path, fill: "none", stroke: "var(--accent)", "stroke-width": 1.8, "stroke-linejoin": "round" });
    const last = points.at(-1);
    parts.push(curve, node("circle", { cx: x(last[0]), cy: y(last[1]), r: 3, fill: "var(--accent)" }));
    if (this.mark !== null) parts.push(line(x(this.mark), TOP, x(this.mark), HEIGHT - BOTTOM, "var(--warn)"));
    this.svg.replaceChildren(...parts);
  }
}
