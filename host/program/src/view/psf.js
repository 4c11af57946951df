// An instrument: the PSFs of all lenses for a source under the pointer, and what each lens sees of the object.
"use strict";

const geometries = new Map();

async function geometryOf(n) {
  if (!geometries.has(n)) geometries.set(n, await json(`/geometry/${n}`));
  return geometries.get(n);
}

/** Draws the outline of the object behind each lens, and the chief ray of its centre. */
function fields(geometry) {
  return (ink, plot) => geometry.anchors_px.forEach(([row, col], l) => {
    const [tall, wide] = geometry.object.map((n) => ((n * geometry.object_um) / 2) * geometry.px_per_um);
    const [x, y] = plot.place(row - tall, col - wide);
    const [right, low] = plot.place(row + tall, col + wide);
    const [cx, cy] = plot.place(row, col);
    ink.lineWidth = 1.2;
    ink.setLineDash(geometry.dead[l] ? [5, 4] : []);
    ink.strokeStyle = geometry.dead[l] ? "#ff8a80" : ["#4dc4d8", "#ffb15c", "#a48bff", "#69d07f"][(l + Math.floor(l / geometry.array[1])) % 4];
    ink.strokeRect(x, y, right - x, low - y);
    ink.setLineDash([]);
    ink.beginPath();
    ink.moveTo(cx - 5, cy); ink.lineTo(cx + 5, cy); ink.moveTo(cx, cy - 5); ink.lineTo(cx, cy + 5);
    ink.stroke();
    ink.fillStyle = ink.strokeStyle;
    ink.font = "11px sans-serif";
    ink.textAlign = "left";
    ink.fillText(`lens ${l}${geometry.dead[l] ? ", dead" : ""}`, cx + 7, cy - 5);
  });
}

/** The PSFs of all lenses for a source under the pointer. */
async function instrument(n, turn) {
  const geometry = await geometryOf(n);
  if (turn !== state.turn) return;
  if (geometry.sensor_only) {
    byId("notes").append(element("li", { textContent: "no bead scan was measured: there are no PSFs to show" }));
    return;
  }
  const [rows, cols] = geometry.object;
  const field = new Plot({ name: "a source in the object: point or click", unit: "", pixel_um: [geometry.object_um, geometry.object_um], look: "grey" }, sharedView());
  const sensor = new Plot({ name: "its image on the sensor", unit: "e-", pixel_um: [geometry.pitch_um, geometry.pitch_um], look: "inferno", root: true }, sharedView());
  const grid = element("div", { className: "windows" });
  grid.style.gridTemplateColumns = `repeat(${geometry.array[1]}, 1fr)`;
  const heading = element("h2", { textContent: "its PSF behind each lens, one scale for all (square root)" });
  const tiles = geometry.anchors_px.map((_, l) => {
    const tile = { canvas: element("canvas"), text: element("figcaption") };
    grid.append(element("figure", {}, tile.canvas, tile.text));
    return tile;
  });
  const box = element("div", { className: "panes" }, field.root, sensor.root, element("section", { className: "pane" }, heading, grid));
  byId("special").replaceChildren(box);
  state.special = [field, sensor];
  let [at, depth, busy, again] = [[(rows - 1) / 2, (cols - 1) / 2], 0, false, false];
  if (geometry.depths_um.length > 1) {
    const slider = element("input", { type: "range", min: 0, max: geometry.depths_um.length - 1, step: 1, value: "0" });
    const text = element("span", { textContent: `${figure(geometry.depths_um[0])} µm` });
    slider.addEventListener("input", () => { depth = slider.valueAsNumber; text.textContent = `${figure(geometry.depths_um[depth])} µm`; show(); });
    box.before(element("label", {}, "Depth of the source ", slider, text));
  }
  const show = async () => {
    if (busy) { again = true; return; }
    busy = true;
    do {
      again = false;
      const um = at.map((v, a) => (v - (geometry.object[a] - 1) / 2) * geometry.object_um);
      try {
        const answer = await ask(`/psf/${n}?depth=${depth}&y_um=${um[0]}&x_um=${um[1]}`);
        const foci = JSON.parse(answer.headers.get("Foci"));
        drawn(foci, new Float32Array(await answer.arrayBuffer()), um);
      } catch (error) { say(error.message, true); }
    } while (again && turn === state.turn);
    busy = false;
  };
  const drawn = (foci, all, um) => {
    const [lenses, high, wide] = foci.shape;
    const [sr, sc] = geometry.sensor;
    const values = new Float32Array(sr * sc);
    const peak = all.reduce((m, v) => Math.max(m, v), 0);
    for (let l = 0; l < lenses; l++) {
      const own = all.subarray(l * high * wide, (l + 1) * high * wide);
      const [top, left] = foci.corners_px[l];
      for (let r = 0; r < high; r++) for (let c = 0; c < wide; c++) {
        const [row, col] = [top + r, left + c];
        if (row >= 0 && col >= 0 && row < sr && col < sc) values[row * sc + col] += own[r * wide + c];
      }
      Object.assign(tiles[l].canvas, { width: wide, height: high });
      const image = new ImageData(coloured(own, { low: 0, high: peak, root: true, map: "inferno" }), wide, high);
      tiles[l].canvas.getContext("2d").putImageData(image, 0, 0);
      const light = own.reduce((sum, v) => sum + v, 0);
      const [row, col] = foci.chief_rays_px[l].map((v) => v.toFixed(1));
      tiles[l].text.textContent = geometry.dead[l] ? `lens ${l}: dead` : `lens ${l}: ${figure(light)} e-, chief ray row ${row}, col ${col}`;
    }
    sensor.marks = [(ink, plot) => foci.chief_rays_px.forEach(([row, col]) => {
      const [x, y] = plot.place(row, col);
      ink.strokeStyle = "#4dc4d8";
      ink.strokeRect(x - 4, y - 4, 8, 8);
    })];
    sensor.show({ rows: sr, cols: sc, values, low: 0, high: peak });
    field.paint();
    heading.textContent = `PSF behind each lens at y ${figure(um[0])}, x ${figure(um[1])} µm; one scale for all, 0 to ${figure(peak)} e- (square root)`;
    byId("main").dataset.psf = `${lenses} lenses`;
  };
  field.marks = [(ink, plot) => {
    ink.fillStyle = "#7c8794";
    geometry.beads_px.forEach(([row, col]) => { const [x, y] = plot.place(row, col); ink.fillRect(x - 1, y - 1, 2, 2); });
    const [x, y] = plot.place(...at);
    ink.strokeStyle = "#fff";
    ink.beginPath();
    ink.arc(x, y, 6, 0, 7);
    ink.moveTo(x - 10, y); ink.lineTo(x + 10, y); ink.moveTo(x, y - 10); ink.lineTo(x, y + 10);
    ink.stroke();
  }];
  field.pointed = (row, col) => { at = [row, col]; field.paint(); show(); };
  field.show({ rows, cols, values: new Uint8Array(rows * cols), low: 0, high: 1 });
  field.bar.replaceChildren(element("span", { textContent: "dots: beads of the scan" }));
  await show();
}
