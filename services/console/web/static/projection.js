// Which part of the site is seen, and where its places are on the canvas. Site metres go east and north, pixels down.

export const MARGIN = { left: 42, right: 12, top: 8, bottom: 24 };
const MOST_PIXELS_A_CELL = 48;
const SEEN_SHARE = .1; // a place that is revealed is at least this share of the frame away from its edge

export class Projection {
  constructor() {
    this.site = { rows: 500, columns: 500, resolution_m: 1 };
    this.size = null;           // of the canvas [CSS pixels]
    this.zoom = 1;              // 1: the whole site
    this.centre = null;         // [x, y]; null: the middle of the site
  }

  get width() { return this.site.columns * this.site.resolution_m; }
  get height() { return this.site.rows * this.site.resolution_m; }

  // The part of the canvas inside the margins.
  get frame() {
    const [w, h] = this.size;
    const right = Math.max(w - MARGIN.right, MARGIN.left + 1), bottom = Math.max(h - MARGIN.bottom, MARGIN.top + 1);
    return { left: MARGIN.left, top: MARGIN.top, right, bottom, width: right - MARGIN.left, height: bottom - MARGIN.top };
  }

  get fitting() { const { width, height } = this.frame; return Math.min(width / this.width, height / this.height); }
  get mostZoom() { return Math.max(1, MOST_PIXELS_A_CELL / (this.site.resolution_m * this.fitting)); }

  // Pixels a metre: the same both ways.
  get scale() { return this.fitting * this.zoom; }

  get middle() { return this.centre ?? [this.width / 2, this.height / 2]; }

  at(x, y) {
    const { left, top, width, height } = this.frame, [cx, cy] = this.middle;
    return [left + width / 2 + (x - cx) * this.scale, top + height / 2 - (y - cy) * this.scale];
  }

  // The site metres of a pixel, off the site as well.
  from(px, py) {
    const { left, top, width, height } = this.frame, [cx, cy] = this.middle;
    return [cx + (px - left - width / 2) / this.scale, cy - (py - top - height / 2) / this.scale];
  }

  // The part of the frame that the site covers [pixels].
  get box() {
    const frame = this.frame, [west, south] = this.at(0, 0), [east, north] = this.at(this.width, this.height);
    return { left: Math.max(frame.left, west), right: Math.min(frame.right, east), top: Math.max(frame.top, north), bottom: Math.min(frame.bottom, south) };
  }

  // The part of the site that is seen [m].
  get window() {
    const { left, right, top, bottom } = this.box, [west, south] = this.from(left, bottom), [east, north] = this.from(right, top);
    return { west, south, east, north };
  }

  // Zooms about a pixel: the place under it stays there.
  zoomTo(zoom, px, py) {
    const [x, y] = this.from(px, py);
    this.zoom = clamp(zoom, 1, this.mostZoom);
    const { left, top, width, height } = this.frame;
    this.centre = [x - (px - left - width / 2) / this.scale, y + (py - top - height / 2) / this.scale];
    this.settle();
  }

  panBy(dx, dy) {
    const [cx, cy] = this.middle;
    this.centre = [cx - dx / this.scale, cy + dy / this.scale];
    this.settle();
  }

  look(zoom, centre) {
    this.zoom = this.size ? clamp(zoom, 1, this.mostZoom) : Math.max(1, zoom);
    this.centre = centre;
    this.settle();
  }

  // Pans as little as is needed for the place to be seen.
  reveal(x, y) {
    const { left, right, top, bottom, width, height } = this.frame, [px, py] = this.at(x, y);
    const dx = width * SEEN_SHARE, dy = height * SEEN_SHARE;
    this.panBy(clamp(px, left + dx, right - dx) - px, clamp(py, top + dy, bottom - dy) - py);
  }

  // Keeps the frame full of site as far as the site reaches.
  settle() {
    if (!this.size) return;
    const { width, height } = this.frame, half = [width / 2 / this.scale, height / 2 / this.scale], whole = [this.width, this.height];
    const at = this.middle.map((value, axis) => (2 * half[axis] >= whole[axis] ? whole[axis] / 2 : clamp(value, half[axis], whole[axis] - half[axis])));
    this.centre = this.zoom <= 1 ? null : at;
  }
}

export function nice(step) {
  const power = 10 ** Math.floor(Math.log10(step));
  return [1, 2, 5, 10].find((factor) => factor * power >= step) * power;
}

export const clamp = (value, low, high) => Math.min(high, Math.max(low, value));
export const tenth = (value) => Math.round(value * 10) / 10;
