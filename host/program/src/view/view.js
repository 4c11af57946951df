// The page: the list of files, and what is in the one that is chosen. Its address (#file=3&frame=7) says what is shown.
"use strict";

const byId = (id) => document.getElementById(id);
const state = { files: [], file: null, shows: null, group: 0, frame: 0, plots: [], extras: [], special: [], turn: 0, busy: false, again: false };

/** Says something, or that something cannot be shown. */
function say(text, bad = false) {
  byId("status").textContent = text;
  byId("status").className = bad ? "bad" : "";
}

/** Asks the program; an error is its text. */
async function ask(path) {
  let answer;
  try {
    answer = await fetch(path);
  } catch {
    throw new Error("The program no longer answers: it has ended. Start `ommatidia view` again, and reload this page.");
  }
  if (!answer.ok) throw new Error((await answer.text()).trim());
  return answer;
}

const json = async (path) => (await ask(path)).json();

/** The pictures of an answer: {rows, cols, values, low, high, label}; all of one size. */
async function pictures(path) {
  const answer = await ask(path);
  const about = JSON.parse(answer.headers.get("Picture"));
  const types = { uint8: Uint8Array, uint16: Uint16Array, float32: Float32Array };
  const all = new types[about.samples](await answer.arrayBuffer());
  const size = about.rows * about.cols;
  return Array.from({ length: about.layers }, (_, i) => ({ ...about, values: all.subarray(i * size, (i + 1) * size) }));
}

const same = (a, b) => Boolean(a && b) && a.join() === b.join();

/** A labelled control. */
function control(text, ...inputs) {
  const label = element("label", {}, text, ...inputs);
  byId("controls").append(label);
  return label;
}

function choice(options, chosen, changed) {
  const select = element("select");
  options.forEach(([value, text]) => select.append(element("option", { value: String(value), textContent: text, selected: value === chosen })));
  select.addEventListener("change", () => changed(select.value));
  return select;
}

/** The list at the left: what has pictures first, then figures and pages, then what is not shown. */
function list() {
  const shown = state.files.filter((file) => file.kind !== "unshown").length;
  byId("count").textContent = shown === 1 ? "1 file" : `${shown} files`;
  const start = prefix(state.files.map((file) => file.name));
  const rank = (kind) => (kind === "unshown" ? 2 : ["figures", "page", "picture"].includes(kind) ? 1 : 0);
  const items = [0, 1, 2].flatMap((section) => state.files.flatMap((file, n) => {
    if (rank(file.kind) !== section) return [];
    const name = file.name.slice(start.length);
    const kind = element("small", { textContent: section === 2 ? `not shown: ${file.why.split("; expected")[0]}` : file.kind.replace("-", " ") });
    if (section === 2) return [element("li", { className: "off", title: `${file.name}: ${file.why}` }, name, kind)];
    return [element("li", {}, element("a", { href: `#file=${n}`, title: file.name }, name, kind))];
  }));
  byId("files").replaceChildren(...items);
}

/** The folder that all names begin with. */
function prefix(names) {
  let start = names.length > 1 ? names[0].slice(0, names[0].lastIndexOf("/") + 1) : "";
  while (start && !names.every((name) => name.startsWith(start))) start = start.slice(0, start.slice(0, -1).lastIndexOf("/") + 1);
  return start;
}

function mark() {
  document.querySelectorAll("#files a").forEach((link) => {
    if (link.getAttribute("href") === `#file=${state.file}`) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  });
}

/** Shows a file. */
async function open(n) {
  const turn = ++state.turn;
  Object.assign(state, { file: n, shows: null, group: 0, frame: 0, plots: [], extras: [], special: [], swipe: null, keys: {} });
  byId("main").dataset.state = "loading";
  for (const id of ["facts", "notes", "special", "controls", "panes", "extra"]) byId(id).replaceChildren();
  byId("title").textContent = state.files[n].name;
  mark();
  say("Reading …");
  try {
    const file = await json(`/file/${n}`);
    if (turn !== state.turn) return;
    say("");
    state.shows = file.shows;
    for (const [name, value] of file.shows.facts) {
      byId("facts").append(element("div", {}, element("dt", { textContent: name }), element("dd", { textContent: value })));
    }
    byId("notes").replaceChildren(...file.shows.notes.map((note) => element("li", { textContent: note })));
    const wanted = new URLSearchParams(location.hash.slice(1));
    state.group = Math.min(Math.max(0, wanted.get("group") | 0), Math.max(0, file.shows.groups.length - 1));
    state.frame = Math.max(0, wanted.get("frame") | 0);
    if (file.kind === "page" || file.kind === "picture") raw(file);
    if (file.kind === "instrument") await instrument(n, turn);
    if (file.report) report(n, !file.shows.groups.length && file.kind !== "instrument");
    if (file.shows.groups.length) await group();
    else byId("main").dataset.state = "ready";
  } catch (error) {
    if (turn === state.turn) { say(error.message, true); byId("main").dataset.state = "failed"; }
  }
}

function raw(file) {
  byId("extra").append(file.kind === "picture"
    ? element("img", { src: `/raw/${state.file}`, alt: file.name })
    : element("iframe", { src: `/raw/${state.file}`, title: file.name }));
}

/** What `ommatidia report` makes of the file, on demand or at once. */
function report(n, at_once) {
  const show = () => byId("extra").replaceChildren(element("iframe", { src: `/report/${n}`, title: "Report" }));
  if (at_once) { show(); return; }
  const button = element("button", { type: "button", textContent: "Show the report" });
  button.addEventListener("click", () => { show(); });
  byId("extra").append(button);
}

/** Controls and panes of the chosen group. */
async function group() {
  const { groups } = state.shows;
  const chosen = groups[state.group];
  state.frame = Math.min(state.frame, chosen.frames - 1);
  byId("controls").replaceChildren();
  byId("panes").replaceChildren();
  Object.assign(state, { plots: [], extras: [], keys: {} });
  if (groups.length > 1) {
    control("Show", choice(groups.map((g, i) => [i, g.name]), state.group, (i) => { state.group = Number(i); state.frame = 0; group(); }));
  }
  sliders(chosen);
  const views = new Map();
  const view = (pane) => {
    const key = pane.size ? pane.size.join() : pane.name;
    if (!views.has(key)) views.set(key, sharedView());
    return views.get(key);
  };
  chosen.panes.forEach((pane, p) => {
    const plot = new Plot(pane, view(pane));
    state.plots.push({ plot, p });
    byId("panes").append(plot.root);
  });
  networks(chosen, view);
  lenses(chosen);
  swipes(chosen, view);
  byId("controls").append(element("output", { id: "label" }));
  await frame();
}

/** The sliders over frames and depths. */
function sliders(chosen) {
  const depths = [...new Set(chosen.z_um)].sort((a, b) => a - b);
  const at = (z) => chosen.z_um.flatMap((v, i) => (v === z ? [i] : []));
  let own = depths.length ? at(chosen.z_um[state.frame]) : null;
  const count = () => (own ? own.length : chosen.frames);
  const index = () => (own ? own.indexOf(state.frame) : state.frame);
  const range = element("input", { type: "range", min: 0, step: 1, id: "frame" });
  const number = element("input", { type: "number", min: 0, step: 1 });
  const total = element("span");
  const renew = () => {
    for (const input of [range, number]) { input.max = count() - 1; input.value = index(); }
    total.textContent = `of ${count()}`;
  };
  const go = (i) => {
    const next = Math.max(0, Math.min(count() - 1, Math.round(i) || 0));
    state.frame = own ? own[next] : next;
    renew();
    frame();
  };
  range.setAttribute("aria-label", "Frame");
  number.setAttribute("aria-label", "Number of the frame");
  range.addEventListener("input", () => go(range.valueAsNumber));
  number.addEventListener("change", () => go(number.valueAsNumber));
  if (chosen.frames > 1) control("Frame", range, number, total).className = "wide";
  state.keys = { ArrowLeft: () => go(index() - 1), ArrowRight: () => go(index() + 1), PageUp: () => go(index() - 10),
    PageDown: () => go(index() + 10), Home: () => go(0), End: () => go(count() - 1) };
  if (depths.length) {
    const depth = element("input", { type: "range", min: 0, max: depths.length - 1, step: 1, value: String(depths.indexOf(chosen.z_um[state.frame])) });
    const text = element("span");
    const to = (i) => {
      const z = depths[Math.max(0, Math.min(depths.length - 1, i))];
      const was = index();
      own = at(z);
      depth.value = depths.indexOf(z);
      text.textContent = `${figure(z)} µm`;
      go(was);
    };
    depth.setAttribute("aria-label", "Depth");
    depth.addEventListener("input", () => to(depth.valueAsNumber));
    text.textContent = `${figure(chosen.z_um[state.frame])} µm`;
    control("Depth", depth, text);
    Object.assign(state.keys, { "[": () => to(depth.valueAsNumber - 1), "]": () => to(depth.valueAsNumber + 1) });
  }
  renew();
}

/** The choice of a network for frames that it fits. */
function networks(chosen, view) {
  const pane = chosen.panes[0];
  const fit = state.files.flatMap((file, n) => (["network", "checkpoint"].includes(file.kind) && same(file.frame, pane.size) ? [[n, file.name]] : []));
  if (!fit.length || pane.look !== "grey") return;
  const known = state.files.find((file) => same(file.object, state.files[fit[0][0]].object) && file.object_um);
  const seen = /^(scene:|frames$)/.test(chosen.name);
  const best = fit.find(([n]) => state.files[n].kind === "network") || fit[0];
  state.network = seen ? best[0] : -1;
  const widths = state.files.findIndex((file) => file.kind === "widths");
  state.limits = false;
  const made = () => {
    state.extras.forEach((plot) => plot.root.remove());
    state.extras = [];
    if (state.network < 0) return;
    const { object, name } = state.files[state.network];
    const truth = chosen.panes.find((p) => same(p.size, object) && p.look === "inferno");
    const pixel_um = truth?.pixel_um || (known ? [known.object_um, known.object_um] : null);
    const names = [`reconstruction by ${name}`, ...(state.limits ? ["lower limit", "upper limit"] : [])];
    state.extras = names.map((text) => {
      const plot = new Plot({ name: text, unit: "of the network", size: object, pixel_um, look: "inferno" }, view({ size: object }));
      byId("panes").append(plot.root);
      return plot;
    });
  };
  made();
  control("Reconstruct with", choice([[-1, "nothing"], ...fit], state.network, (n) => { state.network = Number(n); made(); frame(); }));
  if (widths >= 0) {
    const box = element("input", { type: "checkbox" });
    box.addEventListener("change", () => { state.limits = box.checked && widths; made(); frame(); });
    control("Intervals", box);
  }
}

/** What each lens sees of the object, drawn over frames of its sensor. */
function lenses(chosen) {
  const plots = state.plots.filter(({ plot }) => plot.pane.plane === "sensor" || plot.pane.look === "grey");
  const fit = state.files.flatMap((file, n) => (file.kind === "instrument" && plots.some(({ plot }) => same(file.frame, plot.pane.size)) ? [[n, file.name]] : []));
  if (!fit.length) return;
  const draw = async (n) => {
    const geometry = n < 0 ? null : await geometryOf(n).catch((error) => { say(error.message, true); return null; });
    const all = [...plots.map(({ plot }) => plot), ...(state.swipe ? [state.swipe] : [])];
    all.filter((plot) => !geometry || same(geometry.sensor, plot.pane.size)).forEach((plot) => {
      plot.marks = geometry ? [fields(geometry)] : [];
      plot.paint();
    });
  };
  control("Lenses of", choice([[-1, "none"], ...fit], -1, (n) => draw(Number(n))));
}

/** Two panes of one size, one over the other, with a line between them that moves. */
function swipes(chosen, view) {
  const pairs = chosen.panes.flatMap((a, i) => chosen.panes.flatMap((b, k) => (k > i && same(a.size, b.size) && a.look === b.look ? [[`${i},${k}`, `${a.name} | ${b.name}`]] : [])));
  if (!pairs.length) return;
  const set = (pair) => {
    state.swipe?.root.remove();
    state.swipe = null;
    state.plots.forEach(({ plot }) => { plot.root.hidden = false; });
    if (!pair) return;
    const [a, b] = pair.split(",").map(Number);
    const plot = new Plot({ ...chosen.panes[a], name: `${chosen.panes[a].name} | ${chosen.panes[b].name}` }, view(chosen.panes[a]));
    plot.marks = state.plots[a].plot.marks;
    state.swipe = Object.assign(plot, { pair: [a, b] });
    [a, b].forEach((p) => { state.plots[p].plot.root.hidden = true; });
    state.plots[a].plot.root.before(plot.root);
  };
  const first = chosen.swipe ? chosen.swipe.join() : "";
  state.swipe = null;
  set(first);
  control("Swipe", choice([["", "side by side"], ...pairs], first, (pair) => { set(pair); frame(); }));
}

/** Reads and draws the current frame. While one is read, only the last one that is asked for waits. */
async function frame() {
  if (state.busy) { state.again = true; return; }
  state.busy = true;
  do {
    state.again = false;
    const { turn, file, group: g, frame: f } = state;
    history.replaceState(null, "", `#file=${file}&group=${g}&frame=${f}`);
    try {
      const asked = state.plots.map(({ p }) => pictures(`/data/${file}/${g}/${p}/${f}`).then(([one]) => one));
      const read = (await Promise.allSettled(asked)).map((one) => one.value);
      if (turn !== state.turn || g !== state.group) continue;
      // What can be read is shown, even where another picture of the frame is damaged.
      state.plots.forEach(({ plot }, i) => plot.show(read[i]));
      if (state.swipe) {
        const [a, b] = state.swipe.pair;
        state.swipe.show(read[b] && read[a]);
        state.swipe.swipe(read[b]);
      }
      byId("label").textContent = read.find(Boolean)?.label || "";
      await Promise.all(asked);
      say("");
      if (state.extras.length) await reconstruction(file, g, f);
      byId("main").dataset.state = "ready";
    } catch (error) {
      say(error.message, true);
      byId("main").dataset.state = "failed";
    }
  } while (state.again);
  state.busy = false;
}

async function reconstruction(file, g, f) {
  const plots = state.extras;
  const limits = state.limits === false ? "" : `&widths=${state.limits}`;
  const made = await pictures(`/reconstruct/${file}/${g}/0/${f}?with=${state.network}${limits}`);
  plots.forEach((plot, i) => plot.show(made[i]));
  if (made[0].label) byId("label").textContent += ` Intervals: ${made[0].label}.`;
}

document.addEventListener("keydown", (event) => {
  const inside = event.target.matches?.("input, select, textarea, iframe");
  const action = state.keys?.[event.key];
  if (!action || inside && event.target.id !== "frame" || event.ctrlKey || event.altKey || event.metaKey) return;
  event.preventDefault();
  action();
});

let resizing = 0;
window.addEventListener("resize", () => {
  cancelAnimationFrame(resizing);
  resizing = requestAnimationFrame(() => [...state.plots.map(({ plot }) => plot), ...state.extras, ...state.special, state.swipe].forEach((plot) => plot?.paint()));
});

/** The file in the address; the first that can be shown without one. */
function chosen() {
  const wanted = new URLSearchParams(location.hash.slice(1)).get("file");
  const first = document.querySelector("#files a")?.getAttribute("href").slice("#file=".length);
  const n = Number(wanted ?? first ?? -1);
  return state.files[n] && state.files[n].kind !== "unshown" ? n : -1;
}

function turned() {
  const n = chosen();
  if (n < 0) { say("There is no such file in the list.", true); byId("main").dataset.state = "failed"; return; }
  if (n !== state.file) open(n);
  if (window.innerWidth <= 700 && location.hash) document.querySelector("#list details").open = false;
}

async function start() {
  try {
    const { files, left_out, colours, absent } = await json("/files");
    Object.assign(Colours, { maps: colours, absent });
    state.files = files;
    list();
    if (left_out) byId("files").append(element("li", { className: "off", textContent: `${left_out} more files are not listed` }));
    window.addEventListener("hashchange", turned);
    turned();
  } catch (error) { say(error.message, true); byId("main").dataset.state = "failed"; }
}

start();
