// Small plots over mission time, drawn by uPlot.

import { STEPS_S, colour, pointAt, seeSpan, timeLabel, whenPointedAt, whenSpanSeen, whenThemeChanges } from "./cursor.js";
import { redraw } from "./frames.js";
import uPlot from "./vendor/uplot/uPlot.esm.js";
import { elapsed } from "./words.js";

const HEIGHT = 118, LEAST_RANGE = 1e-9;

export class Chart {
  // digits: of the values. fromZero: whether the axis begins at 0. step: whether a value stays until the next one.
  constructor(figure, digits, fromZero = false, step = false) {
    this.host = figure.querySelector(".plot");
    this.value = figure.querySelector("b");
    this.name = figure.querySelector("figcaption").firstChild.textContent.trim();
    this.unit = figure.querySelector(".dim").textContent;
    this.digits = digits;
    this.points = [];
    this.mark = null;
    this.hovered = false;
    this.draw = () => this.show();
    this.pointed = null; // the moment that is pointed at, here or elsewhere [s]
    this.plot = new uPlot(this.options(fromZero, step), [[], []], this.host);
    this.plot.over.addEventListener("mouseenter", () => { this.hovered = true; });
    this.plot.over.addEventListener("mouseleave", () => { this.hovered = false; pointAt(null, this); });
    new ResizeObserver(() => this.plot.setSize({ width: this.host.clientWidth, height: HEIGHT })).observe(this.host);
    whenPointedAt((at_s, from) => { this.pointed = at_s; if (from !== this) this.point(at_s); this.say(at_s); });
    whenSpanSeen((span) => { this.span = span; this.fit(); });
    whenThemeChanges(() => this.plot.redraw());
    this.say();
  }

  options(fromZero, step) {
    const axis = { stroke: () => colour("--dim"), font: "10px system-ui, sans-serif", ticks: { show: false } };
    const grid = { stroke: () => colour("--line"), width: 1 };
    return {
      width: Math.max(this.host.clientWidth, 120), height: HEIGHT, padding: [8, 10, 0, 0], legend: { show: false },
      scales: { x: { time: false }, y: { range: (_, low, high) => range(low, high, fromZero, step) } },
      axes: [
        { ...axis, size: 22, gap: 3, grid: { show: false }, incrs: STEPS_S, space: 46, values: (_, splits, __, ___, increment) => splits.map((at) => timeLabel(at, increment)) },
        { ...axis, size: 44, gap: 4, grid, space: 26, values: (_, splits) => splits.map((value) => Number(value.toPrecision(6)).toLocaleString("en")) },
      ],
      series: [{}, { stroke: () => colour("--accent"), width: 1.8, points: { show: false }, ...(step ? { paths: uPlot.paths.stepped({ align: 1 }) } : {}) }],
      cursor: { y: false, drag: { x: true, y: false, setScale: false }, points: { show: false } },
      hooks: {
        // It is called for every change of the plot, too; only the pointer over this plot points at a moment.
        setCursor: [(plot) => { if (this.hovered && plot.cursor.left >= 0) pointAt(plot.posToVal(plot.cursor.left, "x"), this); }],
        setSelect: [(plot) => { this.select(plot); }],
        draw: [(plot) => { this.drawMark(plot); }],
      },
    };
  }

  // A span that is dragged over is seen by the timeline and by every plot.
  select(plot) {
    const { left, width } = plot.select;
    if (width < 4) return;
    const span = [plot.posToVal(left, "x"), plot.posToVal(left + width, "x")];
    plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
    seeSpan(span);
  }

  set(points) { this.points = points; this.show(); }

  // A moment to mark [s since the mission's start]; null for none.
  setMark(at) { this.mark = at; this.plot.redraw(false); }

  // New points replace the tail that they overlap.
  extend(points) {
    if (!points.length) return;
    const first = points[0][0];
    this.points = [...this.points.filter(([at]) => at < first), ...points];
    redraw(this.draw);
  }

  show() {
    this.host.dataset.empty = String(this.points.length === 0);
    this.plot.setData([this.points.map(([at]) => at), this.points.map(([, value]) => value)], false);
    this.fit();
    this.say(this.pointed);
  }

  fit() {
    const end = this.points.at(-1)?.[0] ?? 1;
    const [min, max] = this.span ?? [0, Math.max(end, 1)];
    this.plot.setScale("x", { min, max });
    if (!this.hovered) this.point(this.pointed);
  }

  point(at_s) {
    const left = at_s === null ? -10 : this.plot.valToPos(at_s, "x");
    this.plot.setCursor({ left, top: at_s === null ? -10 : 1 }, false);
  }

  // The value at a moment: of the last point before it; null if there is none.
  at(at_s) { return this.points.findLast(([at]) => at <= at_s)?.[1] ?? null; }

  say(at_s = null) {
    const newest = this.points.at(-1)?.[1] ?? null, value = at_s === null ? newest : this.at(at_s);
    this.value.textContent = this.text(value);
    const first = this.points[0]?.[1];
    const about = newest === null ? "no data yet" : `${this.text(first)} at first, ${this.text(newest)} ${this.unit} now`;
    this.host.setAttribute("aria-label", `${this.name}: ${about}${at_s === null ? "" : `; ${this.text(value)} at ${elapsed(at_s)}`}`);
  }

  text(value) { return value === null || value === undefined ? "–" : value.toLocaleString("en", { minimumFractionDigits: this.digits, maximumFractionDigits: this.digits }); }

  drawMark(plot) {
    if (this.mark === null) return;
    const { ctx, bbox } = plot, x = Math.round(plot.valToPos(this.mark, "x", true));
    if (x < bbox.left || x > bbox.left + bbox.width) return;
    ctx.save();
    ctx.strokeStyle = colour("--warn");
    ctx.lineWidth = devicePixelRatio;
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    ctx.restore();
  }
}

// Low and high end of the axis; one value alone gets room around it, and few messages a whole scale.
function range(low, high, fromZero, step) {
  if (low === null || high === null) return [0, 1];
  const bottom = fromZero ? 0 : low, top = step ? Math.max(high, 3) : high;
  const room = top - bottom < LEAST_RANGE ? (Math.abs(top) || 1) * .1 : (top - bottom) * .08;
  return [fromZero ? 0 : bottom - room, top + room];
}
