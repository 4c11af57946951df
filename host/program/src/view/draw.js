// Pictures on a canvas: colours, axes, scale bar, values under the pointer. The server sends numbers; every change of
// contrast, colours or zoom is made here.
"use strict";

const Colours = { maps: {}, absent: [150, 154, 158] };

/** Makes an element with properties and children; texts are texts, never markup. */
function element(name, properties = {}, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

/** A number with four significant figures. */
function figure(v) {
  if (!Number.isFinite(v)) return "no value";
  if (v === 0) return "0";
  const size = Math.abs(v);
  if (size < 1e-3 || size >= 1e6) return v.toExponential(2).replace("-", "−").replace(/^−?/, v < 0 ? "−" : "");
  const text = size >= 1000 ? v.toFixed(Number.isInteger(v) ? 0 : 1) : String(parseFloat(v.toPrecision(4)));
  return text.replace("-", "−");
}

/** The largest of 1, 2, 5 times a power of ten that is at most `most`. */
function round(most) {
  const decade = 10 ** Math.floor(Math.log10(most));
  return [5, 2, 1].map((m) => m * decade).find((v) => v <= most * (1 + 1e-9)) || decade;
}

/** The colour stops of a CSS gradient. */
function ramp(name) {
  const { levels, rgb } = Colours.maps[name];
  const stops = Array.from({ length: 17 }, (_, i) => {
    const at = 3 * Math.round((i / 16) * (levels - 1));
    return `rgb(${rgb.slice(at, at + 3)})`;
  });
  return `linear-gradient(to right,${stops})`;
}

/** Red, green, blue, alpha of each value. */
function coloured(values, { low, high, root, map }) {
  const { levels, rgb } = Colours.maps[map];
  const out = new Uint8ClampedArray(4 * values.length);
  const scale = high > low ? 1 / (high - low) : 0;
  for (let i = 0; i < values.length; i++) {
    let t = (values[i] - low) * scale;
    const known = t === t;
    t = t < 0 ? 0 : t > 1 ? 1 : t;
    if (root) t = Math.sqrt(t);
    const at = 3 * Math.round(t * (levels - 1));
    for (let k = 0; k < 3; k++) out[4 * i + k] = known ? rgb[at + k] : Colours.absent[k];
    out[4 * i + 3] = 255;
  }
  return out;
}

const ROOM = { left: 44, right: 8, top: 6, bottom: 34 };

/** One picture with its axes, its colour bar, and what is drawn over it. */
class Plot {
  /** `pane`: name, unit, pixel_um [height, width] or null, look; `view`: the part that is shown, shared by panes. */
  constructor(pane, view) {
    Object.assign(this, { pane, view, picture: null, other: null, at: 0.5, marks: [], contrast: null });
    this.canvas = element("canvas", { className: "plot", tabIndex: 0 });
    this.canvas.setAttribute("role", "img");
    this.value = element("output", { className: "value" });
    this.bar = element("div", { className: "contrast" });
    this.root = element("section", { className: "pane" }, element("h2", { textContent: pane.name }), this.canvas, this.value, this.bar);
    this.canvas.addEventListener("pointermove", (e) => this.point(e));
    this.canvas.addEventListener("pointerdown", (e) => this.point(e, true));
    this.canvas.addEventListener("pointerup", () => { this.from = null; });
    this.canvas.addEventListener("pointerleave", () => { this.from = null; this.value.textContent = ""; });
    this.canvas.addEventListener("wheel", (e) => this.zoom(e), { passive: false });
    this.canvas.addEventListener("dblclick", () => { Object.assign(this.view, { all: true }); this.view.changed(); });
    view.plots.push(this);
  }

  /** Shows a picture {rows, cols, values, low, high}, or none; the contrast of the one before is kept. */
  show(picture) {
    this.picture = picture;
    if (!picture) { this.clear(); return; }
    if (!this.contrast) this.reset();
    if (this.view.size?.join() !== [picture.rows, picture.cols].join()) {
      Object.assign(this.view, { size: [picture.rows, picture.cols], all: true });
    }
    this.dirty = true;
    this.paint();
  }

  /** Compares with another picture of the same size, which begins at a line that a slider or the pointer moves. */
  swipe(other) {
    if (!this.line) {
      this.line = element("input", { type: "range", className: "swipe", min: 0, max: 1, step: 0.002, value: "0.5" });
      this.line.setAttribute("aria-label", "Line between the two pictures");
      this.line.addEventListener("input", () => { this.at = this.line.valueAsNumber; this.paint(); });
      this.root.insertBefore(this.line, this.value);
    }
    this.other = other;
    this.dirty = true;
    this.paint();
  }

  clear() {
    this.canvas.getContext("2d").clearRect(0, 0, this.canvas.width, this.canvas.height);
    this.value.textContent = "this picture cannot be shown";
  }

  reset() {
    const { low, high, look } = this.picture;
    this.contrast = { low, high, root: Boolean(this.pane.root), map: look || this.pane.look };
    this.makeBar();
  }

  /** The colour bar: limits as numbers and sliders, colours, and a button that finds the limits anew. */
  makeBar() {
    const c = this.contrast;
    const apply = () => { this.dirty = true; this.paint(); };
    const number = (which) => {
      const input = element("input", { type: "number", step: "any", value: String(parseFloat(c[which].toPrecision(5))) });
      input.setAttribute("aria-label", `${which === "low" ? "Lowest" : "Highest"} value of the colours, ${this.pane.name}`);
      input.addEventListener("change", () => {
        if (Number.isFinite(input.valueAsNumber)) { c[which] = input.valueAsNumber; this.makeBar(); apply(); }
      });
      return input;
    };
    const [least, most] = this.range();
    const slider = (which) => {
      const at = (c[which] - least) / (most - least);
      const input = element("input", { type: "range", min: 0, max: 1, step: 0.001, value: String(at) });
      input.setAttribute("aria-label", `${which} end of the colours, ${this.pane.name}`);
      input.addEventListener("input", () => {
        c[which] = least + (most - least) * input.valueAsNumber;
        numbers[which].value = String(parseFloat(c[which].toPrecision(5)));
        apply();
      });
      return input;
    };
    const numbers = { low: number("low"), high: number("high") };
    const colours = element("select", { title: "Colours" });
    for (const name of Object.keys(Colours.maps)) {
      for (const root of [false, true]) {
        const option = { value: `${name} ${root}`, textContent: name + (root ? ", root" : ""), selected: name === c.map && root === c.root };
        colours.append(element("option", option));
      }
    }
    colours.addEventListener("change", () => {
      const [map, root] = colours.value.split(" ");
      Object.assign(c, { map, root: root === "true" });
      this.makeBar();
      apply();
    });
    const auto = element("button", { type: "button", textContent: "Auto", title: "Limits of this frame" });
    auto.addEventListener("click", () => {
      Object.assign(c, { low: this.picture.low, high: this.picture.high });
      this.makeBar();
      apply();
    });
    const strip = element("div", { className: "ramp" });
    strip.style.background = ramp(c.map);
    const ends = element("div", { className: "ends" }, slider("low"), slider("high"));
    const unit = element("span", { textContent: this.pane.unit });
    this.bar.replaceChildren(numbers.low, strip, numbers.high, unit, ends, element("div", { className: "set" }, auto, colours));
  }

  /** Least and largest value, with some room for the sliders. */
  range() {
    let [least, most] = [Infinity, -Infinity];
    for (const v of this.picture.values) { if (v < least) least = v; if (v > most) most = v; }
    least = Math.min(least, this.contrast.low);
    most = Math.max(most, this.contrast.high);
    return most > least ? [least, most] : [least, least + 1];
  }

  /** Draws everything. */
  paint() {
    const { canvas, picture, view } = this;
    const width = canvas.clientWidth;
    if (!picture || !width) return;
    if (view.all) Object.assign(view, { top: 0, left: 0, rows: picture.rows, cols: picture.cols, all: false });
    const ratio = window.devicePixelRatio || 1;
    const [tall, wide] = this.pane.pixel_um || [1, 1];
    let w = width - ROOM.left - ROOM.right;
    let h = (w * view.rows * tall) / (view.cols * wide);
    const most = Math.max(240, 0.72 * window.innerHeight);
    if (h > most) { w *= most / h; h = most; }
    this.box = { x: ROOM.left, y: ROOM.top, w, h };
    canvas.style.height = `${h + ROOM.top + ROOM.bottom}px`;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round((h + ROOM.top + ROOM.bottom) * ratio);
    if (this.dirty) {
      this.images = [picture, this.other].filter(Boolean).map((p) => {
        const image = element("canvas", { width: p.cols, height: p.rows });
        image.getContext("2d").putImageData(new ImageData(coloured(p.values, this.contrast), p.cols, p.rows), 0, 0);
        return image;
      });
      this.dirty = false;
    }
    const ink = canvas.getContext("2d");
    ink.scale(ratio, ratio);
    ink.save();
    ink.beginPath();
    ink.rect(this.box.x, this.box.y, w, h);
    ink.clip();
    ink.imageSmoothingEnabled = false;
    const part = [view.left, view.top, view.cols, view.rows, this.box.x, this.box.y, w, h];
    ink.drawImage(this.images[0], ...part);
    if (this.images[1]) {
      const x = this.box.x + this.at * w;
      ink.save();
      ink.beginPath();
      ink.rect(x, this.box.y, w, h);
      ink.clip();
      ink.drawImage(this.images[1], ...part);
      ink.restore();
      ink.fillStyle = "#fff";
      ink.fillRect(x - 1, this.box.y, 2, h);
    }
    this.marks.forEach((mark) => mark(ink, this));
    this.scaleBar(ink);
    ink.restore();
    this.axes(ink);
    canvas.setAttribute("aria-label", `${this.pane.name}, ${picture.rows} by ${picture.cols} pixels`);
    Object.assign(canvas.dataset, { low: this.contrast.low, high: this.contrast.high, rows: picture.rows, cols: picture.cols });
  }

  /** Place on the canvas of fractional pixel (row, col); a pixel's coordinate is that of its centre. */
  place(row, col) {
    const { x, y, w, h } = this.box;
    return [x + ((col + 0.5 - this.view.left) / this.view.cols) * w, y + ((row + 0.5 - this.view.top) / this.view.rows) * h];
  }

  /** Fractional pixel [row, col] at a place on the canvas. */
  pixel(x, y) {
    const { view, box } = this;
    return [view.top + ((y - box.y) / box.h) * view.rows - 0.5, view.left + ((x - box.x) / box.w) * view.cols - 0.5];
  }

  axes(ink) {
    const style = getComputedStyle(document.documentElement);
    ink.fillStyle = ink.strokeStyle = style.getPropertyValue("--soft");
    ink.font = "11px sans-serif";
    const { x, y, w, h } = this.box;
    const ticks = (from, count, length) => {
      const step = Math.max(1, round((count * 70) / length));
      const first = Math.ceil(from / step) * step;
      return Array.from({ length: Math.max(0, Math.ceil((from + count - 0.5 - first) / step)) }, (_, i) => first + i * step);
    };
    ink.textAlign = "center";
    for (const col of ticks(this.view.left, this.view.cols, w)) {
      const [at] = this.place(0, col);
      ink.fillRect(at, y + h, 1, 4);
      ink.fillText(String(col), at, y + h + 15);
    }
    ink.fillText("col, px", x + w / 2, y + h + 29);
    ink.textAlign = "right";
    for (const row of ticks(this.view.top, this.view.rows, h)) {
      const [, at] = this.place(row, 0);
      ink.fillRect(x - 4, at, 4, 1);
      ink.fillText(String(row), x - 7, at + 4);
    }
    ink.save();
    ink.translate(10, y + h / 2);
    ink.rotate(-Math.PI / 2);
    ink.textAlign = "center";
    ink.fillText("row, px", 0, 0);
    ink.restore();
  }

  scaleBar(ink) {
    if (!this.pane.pixel_um) return;
    const field = this.view.cols * this.pane.pixel_um[1];
    const length = round(field / 4);
    const { x, y, w, h } = this.box;
    const long = (length / field) * w;
    const text = length >= 1000 ? `${length / 1000} mm` : `${parseFloat(length.toPrecision(3))} µm`;
    ink.font = "600 12px sans-serif";
    ink.textAlign = "center";
    const [left, low] = [x + w - long - 10, y + h - 10];
    ink.lineWidth = 3;
    ink.strokeStyle = "rgba(0,0,0,.75)";
    ink.strokeText(text, left + long / 2, low - 7);
    ink.strokeRect(left, low - 2, long, 3);
    ink.fillStyle = "#fff";
    ink.fillRect(left, low - 2, long, 3);
    ink.fillText(text, left + long / 2, low - 7);
  }

  /** Values under the pointer; dragging moves the picture. */
  point(event, pressed) {
    if (!this.box || !this.picture) return;
    const { left, top } = this.canvas.getBoundingClientRect();
    const [x, y] = [event.clientX - left, event.clientY - top];
    const [row, col] = this.pixel(x, y);
    const zoomed = this.view.rows < this.picture.rows || this.view.cols < this.picture.cols;
    if (this.other && !zoomed && (pressed || event.buttons === 1)) {
      this.at = Math.max(0, Math.min(1, (x - this.box.x) / this.box.w));
      this.line.value = this.at;
      this.paint();
    }
    if (pressed) this.from = [row, col];
    else if (this.from && event.buttons === 1 && zoomed) {
      this.view.top = Math.max(0, Math.min(this.picture.rows - this.view.rows, this.view.top + this.from[0] - row));
      this.view.left = Math.max(0, Math.min(this.picture.cols - this.view.cols, this.view.left + this.from[1] - col));
      this.view.changed();
      return;
    }
    const [r, c] = [Math.round(row), Math.round(col)];
    if (r < 0 || c < 0 || r >= this.picture.rows || c >= this.picture.cols) {
      this.value.textContent = "";
      return;
    }
    const unit = this.pane.unit ? ` ${this.pane.unit}` : "";
    const of = (p) => figure(p.values[r * p.cols + c]) + unit;
    let text = `row ${r}, col ${c}: ${of(this.picture)}`;
    if (this.other) text += ` | ${of(this.other)}`;
    if (this.pane.pixel_um) {
      const um = [r - (this.picture.rows - 1) / 2, c - (this.picture.cols - 1) / 2].map((v, a) => v * this.pane.pixel_um[a]);
      text += ` (y ${figure(um[0])}, x ${figure(um[1])} µm from the centre)`;
    }
    this.value.textContent = text;
    this.pointed?.(row, col, Boolean(pressed));
  }

  zoom(event) {
    // The wheel scrolls the page until a picture is clicked.
    if (!this.box || !this.picture || !(event.ctrlKey || document.activeElement === this.canvas)) return;
    event.preventDefault();
    const { left, top } = this.canvas.getBoundingClientRect();
    const [row, col] = this.pixel(event.clientX - left, event.clientY - top);
    const [all, view] = [this.picture, this.view];
    const rows = Math.min(all.rows, Math.max(8, view.rows * (event.deltaY > 0 ? 1.25 : 0.8)));
    const factor = rows / view.rows;
    view.cols = Math.min(all.cols, view.cols * factor);
    view.top = Math.max(0, Math.min(all.rows - rows, row + 0.5 - (row + 0.5 - view.top) * factor));
    view.left = Math.max(0, Math.min(all.cols - view.cols, col + 0.5 - (col + 0.5 - view.left) * factor));
    view.rows = rows;
    view.changed();
  }
}

/** The part that is shown, common to pictures of one size. */
function sharedView() {
  const view = { plots: [], all: true, changed() { this.plots.forEach((plot) => plot.paint()); } };
  return view;
}
