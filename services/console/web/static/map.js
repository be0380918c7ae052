// The map: a layer in colour, and on it what was measured, driven, planned and drawn. Row 0 of a layer is in the south.

const MARGIN = { left: 42, right: 12, top: 8, bottom: 24 };

export class SiteMap {
  constructor(canvas, onHover) {
    this.canvas = canvas;
    this.onPlace = () => {};    // called with a place that was taken, and whether an area is being drawn
    this.onHover = onHover;
    this.site = { rows: 500, columns: 500, resolution_m: 1 };
    this.layer = null;          // { about, values }
    this.picture = null;        // the layer in colour, one pixel a cell
    this.stops = null;
    this.range = [0, 1];
    this.track = null;
    this.rover = null;          // { x_m, y_m, heading_deg, stale }
    this.areas = [];            // { corners, kind, name }
    this.chosen = null;         // [x, y]
    this.cross = null;          // [x, y] while the keyboard leads
    this.draft = [];
    this.preview = null;        // the way of a command that is not sent yet
    this.proposal = null;       // { path, samples, dropped } of the plan that waits for approval
    this.drawing = false;
    this.show = { paths: true, samples: true };
    this.listen();
    new ResizeObserver(() => this.resize()).observe(canvas);
  }

  setSite(site) {
    const known = this.site;
    this.site = site;
    if (known.rows !== site.rows || known.columns !== site.columns || known.resolution_m !== site.resolution_m) this.draw();
  }

  get width() { return this.site.columns * this.site.resolution_m; }
  get height() { return this.site.rows * this.site.resolution_m; }

  resize() {
    const ratio = window.devicePixelRatio || 1;
    const box = this.canvas.getBoundingClientRect();
    this.size = [box.width, box.height];
    this.canvas.width = Math.round(box.width * ratio);
    this.canvas.height = Math.round(box.height * ratio);
    this.ratio = ratio;
    this.draw();
  }

  // Pixels a metre: the same both ways.
  get scale() {
    const [w, h] = this.size;
    return Math.min((w - MARGIN.left - MARGIN.right) / this.width, (h - MARGIN.top - MARGIN.bottom) / this.height);
  }

  // Site metres <-> places on the canvas.
  at(x, y) {
    return [MARGIN.left + x * this.scale, MARGIN.top + (this.height - y) * this.scale];
  }

  place(event) {
    const box = this.canvas.getBoundingClientRect();
    const x = (event.clientX - box.left - MARGIN.left) / this.scale;
    const y = this.height - (event.clientY - box.top - MARGIN.top) / this.scale;
    return x < 0 || y < 0 || x > this.width || y > this.height ? null : [round(x), round(y)];
  }

  valueAt([x, y]) {
    if (!this.layer) return null;
    const { rows, columns, resolution_m: step } = this.layer.about;
    const row = Math.min(rows - 1, Math.floor(y / step)), column = Math.min(columns - 1, Math.floor(x / step));
    return this.layer.values[row * columns + column];
  }

  setLayer(layer, stops, range) {
    this.layer = layer;
    this.stops = stops;
    this.range = range;
    this.picture = coloured(layer, stops, range);
    this.draw();
  }

  listen() {
    const canvas = this.canvas;
    canvas.addEventListener("click", (event) => {
      const place = this.place(event);
      if (place) { this.cross = null; this.take(place); }
    });
    canvas.addEventListener("pointermove", (event) => {
      const place = event.pointerType === "touch" ? null : this.place(event);
      this.onHover(place, event);
    });
    canvas.addEventListener("pointerleave", () => this.onHover(null));
    canvas.addEventListener("keydown", (event) => this.key(event));
    canvas.addEventListener("blur", () => { this.cross = null; this.draw(); });
  }

  key(event) {
    const step = event.shiftKey ? 25 : event.altKey ? 1 : 5;
    const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] };
    if (event.key in moves) {
      const [x, y] = this.cross ?? this.chosen ?? [this.width / 2, this.height / 2];
      this.cross = [clamp(x + moves[event.key][0], 0, this.width), clamp(y + moves[event.key][1], 0, this.height)];
      this.onHover(this.cross);
      this.draw();
    } else if (event.key === "Enter" || event.key === " ") {
      this.take(this.cross ?? [this.width / 2, this.height / 2]);
    } else return;
    event.preventDefault();
  }

  take(place) {
    if (this.drawing) this.draft.push(place); else this.chosen = place;
    this.onPlace(place, this.drawing);
    this.draw();
  }

  draw() {
    if (!this.size) return;
    const context = this.canvas.getContext("2d");
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(name).trim();
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    context.clearRect(0, 0, ...this.size);
    const [left, bottom] = this.at(0, 0), [right, top] = this.at(this.width, this.height);
    context.fillStyle = colour("--field");
    context.fillRect(left, top, right - left, bottom - top);
    if (this.picture) {
      context.imageSmoothingEnabled = right - left < this.picture.width;
      context.drawImage(this.picture, left, top, right - left, bottom - top);
    }
    this.axes(context, colour, left, right, top, bottom);
    context.save();
    context.beginPath();
    context.rect(left, top, right - left, bottom - top);
    context.clip();
    for (const area of this.areas) this.area(context, area.corners, colour(area.kind === "keepout" ? "--keepout" : "--interest"), area.kind !== "keepout", area.name);
    if (this.track) this.mission(context, colour);
    if (this.draft.length) this.drafted(context, colour);
    if (this.proposal) this.proposed(context, colour);
    if (this.preview?.length) {
      this.undecided(context, colour, this.preview);
      this.target(context, this.preview.at(-1), colour("--preview"));
    }
    if (this.chosen) this.target(context, this.chosen, "#fff");
    if (this.cross) this.target(context, this.cross, colour("--planned"), true);
    if (this.rover) this.vehicle(context, colour);
    context.restore();
  }

  axes(context, colour, left, right, top, bottom) {
    context.strokeStyle = colour("--line");
    context.fillStyle = colour("--dim");
    context.font = "11px system-ui, sans-serif";
    context.lineWidth = 1;
    context.strokeRect(left - .5, top - .5, right - left + 1, bottom - top + 1);
    const step = nice(Math.max(this.width, this.height) / (right - left < 420 ? 4 : 6));
    for (let value = 0; value <= Math.max(this.width, this.height); value += step) {
      if (value <= this.width) {
        const [x] = this.at(value, 0);
        context.textAlign = value === 0 ? "left" : value >= this.width - 1 ? "right" : "center";
        context.fillText(value === 0 ? "0 m" : value, x, bottom + 15);
      }
      if (value > 0 && value <= this.height) {
        const [, y] = this.at(0, value);
        context.textAlign = "right";
        context.fillText(value, left - 6, Math.max(y + 4, 12));
      }
    }
    context.textAlign = "right";
    context.fillText("N↑", left - 6, bottom - 2);
  }

  line(context, points, width, style, dash = []) {
    if (points.length < 2) return;
    context.beginPath();
    points.forEach(([x, y], index) => { const place = this.at(x, y); index ? context.lineTo(...place) : context.moveTo(...place); });
    context.setLineDash(dash);
    context.lineWidth = width;
    context.strokeStyle = style;
    context.lineJoin = "round";
    context.stroke();
    context.setLineDash([]);
  }

  mission(context, colour) {
    const track = this.track;
    if (this.show.paths) {
      this.line(context, track.driven_path_m, 3.2, "rgb(0 0 0 / 55%)");
      this.line(context, track.driven_path_m, 1.6, colour("--driven"));
      this.line(context, track.planned_path_m, 3.4, "rgb(0 0 0 / 60%)", [7, 5]);
      this.line(context, track.planned_path_m, 1.9, colour("--planned"), [7, 5]);
    }
    if (this.show.samples) for (const sample of track.samples) {
      const [x, y] = this.at(sample.x_m, sample.y_m);
      context.beginPath();
      context.arc(x, y, 3.6, 0, 7);
      context.fillStyle = colour("--sample");
      context.fill();
      context.lineWidth = 1.4;
      context.strokeStyle = "#fff";
      context.stroke();
      context.beginPath();
      context.arc(x, y, 4.6, 0, 7);
      context.lineWidth = .8;
      context.strokeStyle = "rgb(0 0 0 / 70%)";
      context.stroke();
    }
  }

  undecided(context, colour, path) {
    this.line(context, path, 4.6, "rgb(0 0 0 / 70%)");
    this.line(context, path, 2.6, colour("--preview"), [3, 4]);
  }

  proposed(context, colour) {
    this.undecided(context, colour, this.proposal.path);
    for (const { sample_id, x_m, y_m } of this.proposal.samples) {
      const [x, y] = this.at(x_m, y_m), dropped = this.proposal.dropped.has(sample_id);
      context.fillStyle = dropped ? "rgb(0 0 0 / 70%)" : colour("--preview");
      context.strokeStyle = dropped ? colour("--preview") : "#000";
      context.lineWidth = 1.4;
      context.fillRect(x - 4.5, y - 4.5, 9, 9);
      context.strokeRect(x - 4.5, y - 4.5, 9, 9);
    }
  }

  area(context, corners, style, dashed, name) {
    this.line(context, [...corners, corners[0]], 3.6, "rgb(0 0 0 / 55%)");
    this.line(context, [...corners, corners[0]], 2.1, style, dashed ? [6, 4] : []);
    if (!dashed) {
      context.save();
      context.beginPath();
      corners.forEach((corner, index) => (index ? context.lineTo(...this.at(...corner)) : context.moveTo(...this.at(...corner))));
      context.clip();
      context.strokeStyle = style;
      context.globalAlpha = .55;
      context.lineWidth = 1.2;
      const places = corners.map((corner) => this.at(...corner));
      const low = Math.min(...places.map((p) => p[0])), high = Math.max(...places.map((p) => p[0]));
      const above = Math.min(...places.map((p) => p[1])), below = Math.max(...places.map((p) => p[1]));
      for (let x = low - (below - above); x < high; x += 9) { context.beginPath(); context.moveTo(x, below); context.lineTo(x + below - above, above); context.stroke(); }
      context.restore();
    }
    if (name) label(context, name, this.at(...corners[0]), style);
  }

  drafted(context, colour) {
    const closed = this.draft.length > 2 ? [...this.draft, this.draft[0]] : this.draft;
    this.line(context, closed, 4, "rgb(0 0 0 / 60%)");
    this.line(context, closed, 2, colour("--accent"));
    for (const corner of this.draft) {
      context.beginPath();
      context.arc(...this.at(...corner), 4.5, 0, 7);
      context.fillStyle = colour("--accent");
      context.fill();
      context.strokeStyle = "#000";
      context.stroke();
    }
  }

  target(context, place, style, full = false) {
    const [x, y] = this.at(...place);
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

  vehicle(context, colour) {
    const [x, y] = this.at(this.rover.x_m, this.rover.y_m);
    context.save();
    context.translate(x, y);
    context.beginPath();
    context.arc(0, 0, 13, 0, 7);
    context.fillStyle = "rgb(0 0 0 / 35%)";
    context.fill();
    context.lineWidth = 1.5;
    context.strokeStyle = this.rover.stale ? colour("--bad") : "rgb(255 255 255 / 85%)";
    if (this.rover.stale) context.setLineDash([4, 3]);
    context.stroke();
    context.setLineDash([]);
    context.rotate((this.rover.heading_deg * Math.PI) / 180);
    context.beginPath();
    context.moveTo(0, -10);
    context.lineTo(7, 8);
    context.lineTo(0, 4.5);
    context.lineTo(-7, 8);
    context.closePath();
    context.fillStyle = this.rover.stale ? colour("--bad") : "#5cc8d7";
    context.fill();
    context.strokeStyle = "#001";
    context.lineWidth = 1.2;
    context.stroke();
    context.restore();
  }
}

function coloured({ about, values }, stops, [low, high]) {
  const { rows, columns } = about;
  const picture = new OffscreenCanvas(columns, rows);
  const context = picture.getContext("2d");
  const image = context.createImageData(columns, rows);
  const table = tableOf(stops);
  const pixels = new Uint32Array(image.data.buffer);
  const scale = 255 / Math.max(high - low, 1e-12);
  for (let row = 0; row < rows; row++) {
    const from = row * columns, to = (rows - 1 - row) * columns;
    for (let column = 0; column < columns; column++) {
      const shade = ((values[from + column] - low) * scale) | 0;
      pixels[to + column] = table[shade < 0 ? 0 : shade > 255 ? 255 : shade];
    }
  }
  context.putImageData(image, 0, 0);
  return picture;
}

function tableOf(stops) {
  const fixedColours = stops.map((stop) => [1, 3, 5].map((start) => parseInt(stop.slice(start, start + 2), 16)));
  const table = new Uint32Array(256);
  for (let index = 0; index < 256; index++) {
    const place = (index / 255) * (fixedColours.length - 1), whole = Math.min(Math.floor(place), fixedColours.length - 2), part = place - whole;
    const [r, g, b] = fixedColours[whole].map((value, channel) => Math.round(value + (fixedColours[whole + 1][channel] - value) * part));
    table[index] = (255 << 24) | (b << 16) | (g << 8) | r;
  }
  return table;
}

function label(context, text, [x, y], style) {
  context.font = "600 11px system-ui, sans-serif";
  context.textAlign = "left";
  const width = context.measureText(text).width;
  context.fillStyle = "rgb(0 0 0 / 70%)";
  context.fillRect(x - 2, y - 17, width + 8, 15);
  context.fillStyle = style;
  context.fillText(text, x + 2, y - 6);
}

export function nice(step) {
  const power = 10 ** Math.floor(Math.log10(step));
  return [1, 2, 5, 10].find((factor) => factor * power >= step) * power;
}
const round = (value) => Math.round(value * 10) / 10;
const clamp = (value, low, high) => Math.min(high, Math.max(low, value));
