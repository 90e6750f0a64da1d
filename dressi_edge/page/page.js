"use strict";
// The page from its data. Everything that comes from a file is written as text, never as HTML.

const DATA = JSON.parse(document.getElementById("data").textContent);
const ROOT = document.getElementById("page");
const SVG = "http://www.w3.org/2000/svg";

function h(tag, attributes, ...children) {
  const [name, ...classes] = tag.split("."), e = document.createElement(name || "div");
  if (classes.length) e.className = classes.join(" ");
  for (const [key, x] of Object.entries(attributes || {})) {
    if (key.startsWith("on")) e.addEventListener(key.slice(2), x); else if (x !== null && x !== undefined && x !== false) e.setAttribute(key, x === true ? "" : x);
  }
  e.append(...children.flat(Infinity).filter(c => c !== null && c !== undefined && c !== false));
  return e;
}
function s(tag, attributes, ...children) {
  const e = document.createElementNS(SVG, tag);
  for (const [key, x] of Object.entries(attributes || {})) e.setAttribute(key, x);
  e.append(...children);
  return e;
}

// ---- numbers

function number(x, digits = 4) {
  if (x === null || x === undefined) return "–";
  if (x === 0 || Number.isInteger(x) && Math.abs(x) < 1e6) return x.toLocaleString("en");
  const a = Math.abs(x);
  return a >= 1e5 || a < 1e-3 ? String(x.toExponential(digits - 2)).replace(/\.?0+e/, "e") : String(Number(x.toPrecision(digits)));
}
function bytes(x) {
  for (const unit of ["B", "kB", "MB"]) { if (x < 1000) return `${Number(x.toPrecision(3))} ${unit}`; x /= 1000; }
  return `${Number(x.toPrecision(3))} GB`;
}
function duration(x) {
  x = Math.round(x);
  if (x < 60) return `${x} s`;
  const m = Math.floor(x / 60), two = n => String(n).padStart(2, "0");
  return m < 60 ? `${m}:${two(x % 60)} min` : `${Math.floor(m / 60)}:${two(m % 60)} h`;
}
function many(n, word) { return `${number(n)} ${word}${n === 1 ? "" : "s"}`; }

// ---- head

function head() {
  const dark = () => document.documentElement.dataset.theme === "dark"
    || !document.documentElement.dataset.theme && matchMedia("(prefers-color-scheme: dark)").matches;
  return h("header", {}, h("h1", {}, DATA.title || "dressi_edge"), h("span.soft", {id: "subtitle"}, DATA.subtitle || ""),
    h("button.right", {title: "light or dark", "aria-label": "light or dark",
      onclick: () => { document.documentElement.dataset.theme = dark() ? "light" : "dark"; VIEW && VIEW.gl && tint(); }}, "◐"));
}

// ---- the result

let VIEW = null;

function tint() {
  const hex = getComputedStyle(document.documentElement).getPropertyValue("--accent").trim();
  VIEW.ink = [1, 3, 5].map(k => parseInt(hex.slice(k, k + 2), 16) / 255).concat(1);
  VIEW.draw();
}

function viewer() {
  const text = document.getElementById("model").textContent.trim();
  if (!text && !DATA.live) return null;
  const canvas = h("canvas", {tabindex: 0, "aria-label": "The result in 3D. Drag to turn, shift-drag to move, click and scroll to zoom; arrow keys, + and - work too."});
  const counts = h("span.soft.small.right", {id: "counts"});
  const buttons = ["as it is", "clay", "normals"].map((name, k) => h("button", {"aria-pressed": String(k === 0), "data-mode": k,
    onclick: () => { CHOSEN = true; mode(k); }}, name));
  const toggle = (name, key) => h("button", {"aria-pressed": "false", "data-toggle": key, onclick: e => {
    VIEW[key] = !VIEW[key]; e.target.setAttribute("aria-pressed", VIEW[key]); VIEW.draw();
  }}, name);
  const save = h("button", {title: "save the model as .glb", onclick: () => {
    const a = h("a", {href: URL.createObjectURL(new Blob([MODEL], {type: "model/gltf-binary"})), download: `${(DATA.title || "model").replace(/\.\w+$/, "")}.glb`});
    a.click(); URL.revokeObjectURL(a.href);
  }}, "save .glb");
  const box = h("div.panel.stage", {}, canvas, h("div.bar", {}, buttons, toggle("edges", "wire"),
    (DATA.cameras || []).length ? toggle("cameras", "showCameras") : null, h("button", {onclick: () => VIEW.reset(), title: "double-click does it too"}, "reset"), save, counts));
  queueMicrotask(async () => {
    VIEW = new Viewer(canvas);
    window.dressi = {viewer: VIEW, data: DATA};
    if (!VIEW.gl) { canvas.replaceWith(h("p.notice", {}, "This browser has no WebGL 2, which the 3D view needs. The model is in this page all the same: save it as .glb.")); }
    if (text) await model(decoded(text));
  });
  return box;
}

let MODEL = null, CHOSEN = false; // whether somebody has chosen how to look at it
function mode(k) {
  VIEW.mode = k; VIEW.draw();
  document.querySelectorAll("[data-mode]").forEach(b => b.setAttribute("aria-pressed", String(b.dataset.mode === String(k))));
}
function decoded(text) { return Uint8Array.from(atob(text), c => c.charCodeAt(0)); }
async function model(data, keep = false) {
  MODEL = data;
  if (!VIEW || !VIEW.gl) return;
  await VIEW.load(data, DATA.cameras, keep);
  if (!CHOSEN) mode(VIEW.plain ? 1 : 0);
  tint();
  document.getElementById("counts").textContent = `${many(VIEW.counts.faces, "triangle")}`;
}

function facts() {
  const phases = DATA.phases || [], views = DATA.views || {}, total = phases.reduce((t, p) => t + (p.seconds || 0), 0);
  const big = [];
  if (views.iou_mean !== undefined) big.push(["silhouettes (IoU)", views.iou_mean.toFixed(4)]);
  if (views.psnr_mean !== undefined) big.push(["colours inside", `${views.psnr_mean.toFixed(1)} dB`]);
  if (total) big.push(["stepping", duration(total)]);
  const rows = phases.map(p => h("div", {style: "margin-top:14px"}, h("h3", {}, p.name, p.interrupted ? h("span.soft", {}, "  ended early") : null),
    h("div.progress", {title: `${p.steps} of ${p.of} steps`}, h("i", {style: `width:${100 * p.steps / Math.max(p.of, 1)}%`})),
    h("dl", {}, h("dt", {}, "steps"), h("dd", {}, `${number(p.steps)} of ${number(p.of)}`),
      p.loss_first !== undefined ? [h("dt", {}, "loss"), h("dd", {}, `${number(p.loss_first)} → ${number(p.loss_last)}`)] : null,
      p.steps ? [h("dt", {}, "a step"), h("dd", {}, `${number(p.ms_per_step, 3)} ms`)] : null,
      p.seconds_left ? [h("dt", {}, "left"), h("dd", {}, duration(p.seconds_left))] : null)));
  const where = Object.entries(DATA.where || {}).map(([k, x]) => [h("dt", {}, k), h("dd", {}, String(x))]);
  return h("div.panel.facts", {id: "facts"}, big.length ? h("div.big", {}, big.map(([k, x]) => h("div", {}, h("b", {}, x), h("span", {}, k)))) : null,
    where.length ? h("dl", {}, where) : null, rows);
}

// ---- pictures

function pictures() {
  const rows = DATA.pictures || [];
  if (!rows.length) return null;
  const count = Math.max(...rows.map(r => r.images.length)), names = (DATA.cameras || []).map(c => c.name);
  const dialog = h("dialog", {onclick: () => dialog.close()});
  const picture = (src, label, k) => h("img", {src, alt: `${label}, view ${names[k] || k}`, loading: "lazy", onclick: () => {
    dialog.replaceChildren(h("img", {src, alt: ""})); dialog.showModal();
  }});
  const heads = [...Array(count).keys()].map(k => h("th", {title: names[k]}, DATA.cameras && DATA.cameras[k] && VIEWABLE
    ? h("button", {title: "look from there", onclick: () => { VIEW.look(DATA.cameras[k]); VIEW.canvas.scrollIntoView({behavior: "smooth", block: "center"}); }}, names[k] || String(k)) : names[k] || String(k)));
  const more = names.length > count ? h("p.soft.small", {}, `the first ${count} of ${names.length} views`) : null;
  return section("Views", h("div.panel.sheet", {id: "sheet"}, h("table", {}, h("thead", {}, h("tr", {}, h("th", {}), heads)),
    h("tbody", {}, rows.map(r => h("tr", {}, h("th", {}, r.label), r.images.map((src, k) => h("td", {}, picture(src, r.label, k))))))), more, dialog), "views");
}
const VIEWABLE = !!document.getElementById("model").textContent.trim() || !!DATA.live;

// ---- curves

function ticks(low, high, log) {
  if (log) {
    const found = [];
    for (let d = Math.floor(low); d <= Math.ceil(high); d++) for (const f of high - low < 2 ? [1, 2, 5] : [1]) {
      const y = d + Math.log10(f);
      if (y >= low && y <= high) found.push(y);
    }
    if (found.length > 1) return found.filter((_, k) => k % Math.ceil(found.length / 7) === 0);
    return [low, (low + high) / 2, high];
  }
  const rough = (high - low) / 5, power = 10 ** Math.floor(Math.log10(rough || 1));
  const step = [1, 2, 5, 10].map(f => f * power).find(x => x >= rough) || 1, found = [];
  for (let x = Math.ceil(low / step) * step; x <= high + 1e-9 * step; x += step) found.push(x);
  return found;
}

function chart(curve) {
  const lines = [["loss", curve.loss], ...Object.entries(curve.terms || {})].map(([name, points], k) => ({name, points, color: `var(--c${k % 6})`}));
  const shown = lines.map(l => l.points.filter(p => Number.isFinite(p[1]))), all = shown.flat();
  if (!all.length) return null;
  const positive = all.filter(p => p[1] > 0), log = positive.length > 1, y = v => log ? Math.log10(v) : v, values = (log ? positive : all).map(p => y(p[1]));
  let low = Math.min(...values), high = Math.max(...values);
  const margin = 0.06 * (high - low) || 0.1;
  low -= margin; high += margin;
  const W = 520, H = 250, L = 58, R = 12, T = 10, B = 28, x1 = Math.max(...all.map(p => p[0]), 1);
  const px = x => L + x / x1 * (W - L - R), py = v => T + (high - v) / (high - low) * (H - T - B);
  const svg = s("svg", {viewBox: `0 0 ${W} ${H}`, role: "img", "aria-label": `loss of phase ${curve.phase} over ${x1} steps`});
  for (const t of ticks(low, high, log)) svg.append(s("line", {class: "grid", x1: L, x2: W - R, y1: py(t), y2: py(t)}),
    s("text", {x: L - 8, y: py(t) + 4, "text-anchor": "end"}, number(log ? 10 ** t : t, 3)));
  for (const t of ticks(0, x1, false)) svg.append(s("text", {x: px(t), y: H - 8, "text-anchor": "middle"}, number(t)));
  lines.forEach((l, k) => {
    const points = shown[k].filter(p => !log || p[1] > 0).map(p => `${px(p[0]).toFixed(1)},${py(y(p[1])).toFixed(1)}`);
    svg.append(s("polyline", {class: "line", points: points.join(" "), style: `stroke:${l.color}${k ? ";opacity:0.85" : ";stroke-width:2.6"}`}));
  });
  const rule = s("line", {class: "grid", y1: T, y2: H - B, style: "visibility:hidden;stroke:var(--soft)"});
  svg.append(rule);
  const legend = h("div.legend");
  const say = at => legend.replaceChildren(...lines.map((l, k) => {
    const p = shown[k][at === null ? shown[k].length - 1 : at];
    return h("span", {}, h("i", {style: `background:${l.color}`}), l.name, h("span.soft", {}, ` ${p ? number(p[1]) : "–"}`));
  }), h("span.soft", {}, `step ${number(lines[0].points[at === null ? lines[0].points.length - 1 : at][0])}`));
  svg.addEventListener("pointermove", e => {
    const box = svg.getBoundingClientRect(), x = ((e.clientX - box.left) / box.width * W - L) / (W - L - R) * x1, xs = lines[0].points.map(p => p[0]);
    const at = xs.reduce((best, v, k) => Math.abs(v - x) < Math.abs(xs[best] - x) ? k : best, 0);
    rule.setAttribute("x1", px(xs[at])); rule.setAttribute("x2", px(xs[at])); rule.style.visibility = "visible"; say(at);
  });
  svg.addEventListener("pointerleave", () => { rule.style.visibility = "hidden"; say(null); });
  say(null);
  return h("div.panel.chart", {}, h("h3", {}, curve.phase, h("span.soft.small", {}, log ? "  log scale" : "")), legend, svg);
}

function curves() {
  const found = (DATA.curves || []).map(chart).filter(Boolean);
  const terms = (DATA.curves || []).some(c => Object.keys(c.terms || {}).length);
  return found.length ? section("Loss", [terms ? h("p.soft.small", {}, "The loss is the weighted sum of its terms, which are drawn as they are, without weights.") : null,
    h("div.charts", {id: "charts"}, found)], "loss") : null;
}

// ---- tables

function section(title, content, id) { return h("section", {id}, h("h2", {}, title), content); }

function list(heads, rows, numbers = []) {
  const cls = k => numbers.includes(k) ? {class: "num"} : {};
  return h("div.panel.scroll", {}, h("table.list", {}, h("thead", {}, h("tr", {}, heads.map((x, k) => h("th", cls(k), x)))),
    h("tbody", {}, rows.map(r => h("tr", {}, r.map((x, k) => h("td", cls(k), x)))))));
}

function parameters() {
  const found = DATA.parameters || [];
  if (!found.length) return null;
  return section("Parameters", list(["name", "shape", "least", "mean", "largest", "optimized by"], found.map(p => [
    p.numbers ? [p.name, h("div.soft.small", {}, p.numbers.map(x => number(x)).join("  "))] : p.name,
    p.shape.length ? p.shape.join(" × ") : "one number", number(p.least), number(p.mean), number(p.largest), p.phases.join(" ")]), [2, 3, 4]), "parameters");
}

function times() {
  const plans = ((DATA.bundle || {}).plans || []).filter(p => p.ms !== null && p.ms !== undefined);
  if (!plans.length) return null;
  const most = Math.max(...plans.map(p => p.ms));
  return section("Time", [h("p.soft.small", {}, "Milliseconds on the device, medians by its own clock; each stage's are with the stages below."),
    list(["plan", "", "stages", "moved", "ms", ""], plans.map(p => [p.name, h("span", {class: `kind ${p.kind}`}, label(p.kind)), number(p.stages.length),
      bytes(p.bytes_per_step), number(p.ms, 3), h("div.meter", {style: "width:180px;margin-top:8px"}, h("i", {style: `width:${100 * p.ms / most}%`}))]), [2, 3, 4])], "time");
}

// ---- stages

function label(kind) { return {prepare: "cached", phase: "phase", output: "on demand", enter: "before the phase", leave: "after the phase"}[kind] || kind; }

function source(r) {
  if (r.substage !== undefined) return `substage ${r.substage} above`;
  if (r.stage !== undefined) return `stage ${r.stage}`;
  if (r.value) return r.value;
  if (r.constant) return "constants";
  return r.plan ? `cached: ${r.plan}` : `image ${r.image}`;
}

function reads(sub) {
  const by = new Map();
  for (const r of sub.reads) { const key = source(r); if (!by.has(key)) by.set(key, []); by.get(key).push(r); }
  return h("ul", {}, [...by].map(([key, rs]) => h("li", {class: rs[0].plan ? "cached" : null, title: rs.map(r => `image ${r.image}`).join(", ")}, key,
    rs.length > 1 ? ` × ${rs.length}` : "", rs.some(r => r.how !== "sampled") ? h("span.soft", {}, ` ${rs.find(r => r.how !== "sampled").how}`) : "")));
}

function holds(sub, stage) {
  const draws = stage.groups ? `compute, ${stage.groups.join(" × ")} workgroups${sub.indirect ? " at most, as many as the device counts" : ""}` : `${many(sub.draws, "draw")}, ${sub.indirect ? "as many vertices as the device counts" : many(sub.vertices, "vertex").replace("vertexs", "vertices")}${sub.depth ? ", depth test" : ""}`;
  if (!sub.holds.length) return h("span.soft", {}, draws);
  const total = sub.holds.reduce((t, [, n]) => t + n, 0), first = sub.holds.slice(0, 7), left = sub.holds.length - first.length;
  return [h("code", {title: sub.holds.map(([name, n]) => n > 1 ? `${name} × ${n}` : name).join("\n")},
    first.map(([name, n]) => n > 1 ? `${name}×${n}` : name).join("  "), left > 0 ? `  … ${left} more` : ""),
  h("div.soft", {}, `${total > 1 ? `${total} functions in one shader; ` : ""}${draws}`)];
}

function flow(plan) {
  const box = h("div.flow"), rows = h("div.rows"), arcs = s("svg", {}), n = plan.stages.length, most = Math.max(...plan.stages.map(x => x.ms || 0));
  const needs = plan.needs.length ? ` Before it run, if they have not: ${plan.needs.join(", ")}.` : "";
  const gives = [plan.updates.length ? `It updates ${plan.updates.join(", ")}.` : "", plan.outputs.length ? `It gives out ${plan.outputs.join(", ")}.` : ""].join(" ");
  rows.append(arcs, h("div.row.head", {}, h("span", {}, "#"), h("span", {}, "size"), h("span", {}, "what is fused"), h("span", {}, "reads from"), h("span", {}, "attachments"), h("span", {}, "moved, ms")));
  const lines = plan.stages.map((stage, k) => {
    const row = h("div.row", {"data-stage": k}, h("b", {}, String(k)), h("span", {}, `${stage.width} × ${stage.height}`),
      h("div", {}, stage.substages.map(sub => h("div.sub", {}, holds(sub, stage)))), h("div", {}, stage.substages.map(sub => h("div.sub", {}, reads(sub)))),
      h("ul", {}, stage.attachments.map(a => h("li", {title: `image ${a.image}, ${a.load}${a.stored ? "" : ", not stored"}`}, h("code", {}, short(a.format)),
        a.value ? ` ${a.value}` : "", h("span.soft", {}, ` ${a.load === "overwritten" ? "" : a.load}${a.stored ? "" : " not stored"}`)))),
      h("div", {}, bytes(stage.bytes), stage.ms !== null ? [h("div", {}, `${number(stage.ms, 3)} ms`), h("div.meter", {}, h("i", {style: `width:${most ? 100 * stage.ms / most : 0}%`}))] : null));
    row.addEventListener("pointerenter", () => mark(k)); row.addEventListener("pointerleave", () => mark(null));
    rows.append(row);
    return row;
  });
  const edges = new Map();
  plan.stages.forEach((stage, k) => stage.substages.forEach(sub => sub.reads.forEach(r => {
    if (r.stage !== undefined) edges.set(`${r.stage} ${k}`, [r.stage, k]);
  })));
  const paths = [];
  const lay = () => {
    const y = lines.map(row => row.offsetTop + 18), high = rows.offsetHeight;
    arcs.setAttribute("width", 84); arcs.setAttribute("height", high); arcs.replaceChildren(); paths.length = 0;
    for (const [a, b] of edges.values()) {
      const reach = Math.min(78, 10 + 68 * Math.sqrt((b - a) / Math.max(n, 8))), path = s("path", {d: `M84 ${y[a]} C ${84 - reach} ${y[a]} ${84 - reach} ${y[b]} 84 ${y[b]}`});
      arcs.append(path); paths.push([path, a, b]);
    }
  };
  const mark = k => {
    lines.forEach(row => row.classList.remove("source", "reader"));
    for (const [path, a, b] of paths) {
      path.setAttribute("class", k === null ? "" : b === k ? "in" : a === k ? "out" : "");
      if (k !== null && b === k) lines[a].classList.add("source");
      if (k !== null && a === k) lines[b].classList.add("reader");
    }
  };
  new ResizeObserver(lay).observe(rows);
  box.append(h("p.intro.small.soft", {}, `${plan.meaning[0].toUpperCase()}${plan.meaning.slice(1)}. ${gives}${needs}`), rows);
  return box;
}

function short(format) { return format.replace(/^R32G32B32A32/, "rgba32").replace(/^R32G32/, "rg32").replace(/^R32/, "r32").replace(/^R16G16B16A16/, "rgba16").replace(/^R16G16/, "rg16").replace(/^R16/, "r16").replace("_SFLOAT", "f").replace("_SINT", "i"); }

function stages() {
  const b = DATA.bundle;
  if (!b) return null;
  const stored = b.images.reduce((t, i) => t + i.bytes, 0), first = b.plans.find(p => p.kind === "phase");
  return section("Stages", [h("p.soft.small", {}, `${many(b.plans.length, "plan")} of ${many(b.plans.reduce((t, p) => t + p.stages.length, 0), "stage")} (render passes), ${many(b.pipelines, "pipeline")}, ${many(b.shaders, "shader")}, ${many(b.images.length, "image")} of ${bytes(stored)}. `
    + "A stage holds substages that share the tile; a substage is one shader into which functions of the graph were fused. Point at a stage: lines show where what it reads was written, and who reads what it writes."),
  b.plans.map(plan => {
    const d = h("details.panel.plan", {open: plan === first, "data-plan": plan.name}, h("summary", {}, h("b", {}, plan.name), h("span", {class: `kind ${plan.kind}`}, label(plan.kind)),
      h("span.soft.small", {}, [plan.functions ? many(plan.functions, "function") : "", many(plan.substages, "substage"), many(plan.stages.length, "stage"), `${bytes(plan.bytes_per_step)} moved`,
        plan.ms !== null ? `${number(plan.ms, 3)} ms` : ""].filter(Boolean).join(" · "))));
    const fill = () => { if (d.open && !d.querySelector(".flow")) d.append(flow(plan)); };
    d.addEventListener("toggle", fill); fill();
    return d;
  })], "stages");
}

function limits() {
  const b = DATA.bundle;
  if (!b) return null;
  const device = b.limits.some(l => l.device !== null), profile = b.limits.some(l => l.profile !== null);
  const heads = ["limit", "needed", profile ? "profile allows" : null, device ? "device has" : null].filter(x => x !== null);
  return section("Profile and limits", [h("p.soft.small", {}, `Compiled for the device profile ${b.profile}.`),
    list(heads, b.limits.map(l => [l.name, number(l.needed), profile ? number(l.profile) : null, device ? number(l.device) : null].filter((_, k) => k < 2 || k === 2 && profile || k === 3 && device)), [1, 2, 3]),
    h("p.soft.small", {style: "margin-top:10px"}, `Formats: ${Object.entries(b.formats).map(([name, uses]) => `${name} (${uses.join(", ")})`).join("; ")}.`)], "limits");
}

function versions() {
  const found = {...(DATA.versions || {})};
  if (DATA.bundle) found["bundle, SHA-256"] = DATA.bundle.digest;
  if (!Object.keys(found).length) return null;
  return section("Versions", list(["", ""], Object.entries(found).map(([k, x]) => [k, String(x)])), "versions");
}

// ---- the whole, and what changes while it runs

function show() {
  const view = viewer(), hasFacts = (DATA.phases || []).length || Object.keys(DATA.where || {}).length;
  ROOT.replaceChildren(...[DATA.live ? h("div", {id: "live"}) : null, head(),
    h("main", {}, view || hasFacts ? h("div.top", {}, view, hasFacts ? facts() : null) : null, h("div", {id: "pictures"}, pictures() || ""), h("div", {id: "curves"}, curves() || ""),
      parameters(), times(), stages(), limits(), versions()),
    h("footer", {}, DATA.footer || "Made by dressi_edge. All of it is in this one file; nothing is fetched.")].filter(Boolean));
  if (DATA.live) live();
}

function live() {
  const token = new URLSearchParams(location.search).get("token") || "", box = document.getElementById("live"), seen = {model: 0, pictures: 0};
  const ask = (path, method = "GET") => fetch(`${path}?token=${encodeURIComponent(token)}`, {method, cache: "no-store"});
  const said = h("span.soft", {id: "said"});
  const button = (name, path, text) => h("button", {"data-do": path, title: text, onclick: async e => {
    e.target.disabled = true;
    said.textContent = (await ask(path, "POST")).ok ? `${name}: asked for` : "refused";
    if (path !== "stop") setTimeout(() => { e.target.disabled = false; }, 800);
  }}, name);
  box.append(h("div", {style: "max-width:1180px;margin:0 auto;padding:12px 24px 0;display:flex;gap:8px;align-items:center;flex-wrap:wrap"},
    button("stop", "stop", "end after the step in flight; what there is is written"),
    DATA.live.checkpoint ? button("checkpoint", "checkpoint", "write the checkpoint now") : null, said));
  let missed = 0;
  const poll = async () => {
    try {
      const news = await (await ask("data")).json();
      missed = 0;
      if (news.begun && !DATA.live.begun) { location.reload(); return; }
      Object.assign(DATA, news.data);
      document.getElementById("subtitle").textContent = DATA.subtitle || "";
      const old = document.getElementById("facts"), made = facts();
      if (old) old.replaceWith(made); else document.querySelector(".top").append(made);
      document.getElementById("curves").replaceChildren(curves() || "");
      if (news.model > seen.model) { await model(new Uint8Array(await (await ask("model")).arrayBuffer()), seen.model > 0); seen.model = news.model; }
      if (news.pictures > seen.pictures) {
        DATA.pictures = await (await ask("pictures")).json(); seen.pictures = news.pictures;
        document.getElementById("pictures").replaceChildren(pictures() || "");
      }
      if (news.over) { box.querySelectorAll("button").forEach(b => { b.disabled = true; }); return; }
    } catch (error) {
      if (++missed > 5) { said.textContent = "the run has ended or cannot be reached"; box.querySelectorAll("button").forEach(b => { b.disabled = true; }); return; }
    }
    setTimeout(poll, 700);
  };
  poll();
}

show();
