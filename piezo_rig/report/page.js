"use strict";
// Reading values off a plot, a plot on its own scale, and the residual of one condition.
// The page says all it has to say without this.
document.querySelectorAll(".script").forEach((e) => { e.hidden = false; });
const read = document.createElement("div");
read.id = "read";
read.hidden = true;
document.body.append(read);
const short = (v) => String(Number(v.toPrecision(4))).replace("-", "\u2212");

function nearest(svg, event) {
  const at = new DOMPoint(event.clientX, event.clientY)
    .matrixTransform(svg.getScreenCTM().inverse());
  let best = null;
  for (const panel of svg.querySelectorAll(".panel")) {
    const [left, top, width, height] = panel.dataset.box.split(" ").map(Number);
    if (at.x < left || at.x > left + width || at.y < top || at.y > top + height) continue;
    for (const line of panel.querySelectorAll("polyline")) {
      for (const p of line.points) {
        const far = Math.hypot(p.x - at.x, 0.6 * (p.y - at.y));
        if (far < 25 && (!best || far < best.far)) best = { far, p, line, panel };
      }
    }
  }
  return best;
}

function values(panel, p) {
  const [left, top, width, height] = panel.dataset.box.split(" ").map(Number);
  const [x0, x1, log] = panel.dataset.x.split(" ").map(Number);
  const [y0, y1] = panel.dataset.y.split(" ").map(Number);
  const s = (p.x - left) / width, t = 1 - (p.y - top) / height;
  return [log ? x0 * Math.pow(x1 / x0, s) : x0 + s * (x1 - x0), y0 + t * (y1 - y0)];
}

document.addEventListener("mousemove", (event) => {
  const svg = event.target.closest ? event.target.closest("svg.plot") : null;
  const hit = svg && nearest(svg, event);
  read.hidden = !hit;
  if (!hit) return;
  const [x, y] = values(hit.panel, hit.p);
  const [ux, uy] = hit.panel.dataset.units.split("|");
  read.textContent = `${hit.line.dataset.label}: ${short(y)} ${uy} at ${short(x)} ${ux}`;
  read.style.left = Math.min(event.clientX + 14, innerWidth - read.offsetWidth - 4) + "px";
  read.style.top = (event.clientY - 30) + "px";
});

document.querySelectorAll("button[data-swap]").forEach((button) => {
  const plots = button.closest("figure").querySelectorAll(".view");
  const texts = [button.textContent, "both on one scale"];
  let own = 0;
  button.addEventListener("click", () => {
    own = 1 - own;
    plots.forEach((plot, i) => { plot.hidden = i !== own; });
    button.textContent = texts[own];
  });
});

// Events one by one: the buttons and the numbers in the table choose.
document.querySelectorAll("figure.steps").forEach((figure) => {
  const steps = [...figure.querySelectorAll(".step")];
  const [back, on] = figure.querySelectorAll("button[data-step]");
  let now = 0;
  const show = (k) => {
    now = Math.min(Math.max(k, 0), steps.length - 1);
    steps.forEach((step, i) => { step.hidden = i !== now; });
    back.disabled = now === 0;
    on.disabled = now === steps.length - 1;
    figure.querySelector(".at").textContent = `figure ${now + 1} of ${steps.length}`;
  };
  [back, on].forEach((b) => b.addEventListener("click", () => show(now + Number(b.dataset.step))));
  steps.forEach((step, i) => document.querySelectorAll(`a[href="#${step.id}"]`).forEach((a) =>
    a.addEventListener("click", (event) => {
      event.preventDefault();
      show(i);
      figure.scrollIntoView({ block: "nearest" });
    })));
  show(0);
});

// The residual of one condition on one rung: redrawn into the figure that stands there already.
const held = document.getElementById("closer-data");
if (held) {
  const data = JSON.parse(held.textContent);
  const figure = held.closest("figure");
  const svg = figure.querySelector("svg.plot");
  const plain = svg.innerHTML;
  const [rung, condition, fixed] = figure.querySelectorAll("select, input");
  const L = 62, T = 44, W = 788, H = 198;
  const el = (text, x, y, anchor, kind) =>
    `<text class="${kind}" x="${x}" y="${y}" text-anchor="${anchor}">${text}</text>`;
  const ticks = (a, b, n) => {
    const raw = (b - a) / n, p = Math.pow(10, Math.floor(Math.log10(raw)));
    const step = p * [1, 2, 5, 10].find((m) => m * p >= raw), out = [];
    for (let k = Math.ceil(a / step - 1e-9); k * step <= b + 1e-9 * step; k++) out.push(k * step);
    return out;
  };
  const draw = () => {
    if (condition.value === "" ) { svg.innerHTML = plain; fixed.disabled = rung.disabled = true; return; }
    fixed.disabled = rung.disabled = false;
    const c = data.conditions[Number(condition.value)], r = Number(rung.value);
    const seen = (fixed.checked ? c.y.flat() : c.y[r]).flat();
    const x0 = Math.min(...c.x.flat()), x1 = Math.max(...c.x.flat());
    const y0 = Math.min(-data.floor, ...seen) * 1.08, y1 = Math.max(data.floor, ...seen) * 1.08;
    const X = (v) => L + W * (v - x0) / (x1 - x0), Y = (v) => T + H * (1 - (v - y0) / (y1 - y0));
    let s = `<g class="panel" data-box="${L} ${T} ${W} ${H}" data-x="${x0} ${x1} 0" ` +
      `data-y="${y0} ${y1}" data-units="V|nm"><rect class="band" x="${L}" width="${W}" ` +
      `y="${Y(data.floor)}" height="${Math.max(Y(-data.floor) - Y(data.floor), 0.5)}"/>`;
    for (const v of ticks(y0, y1, 5)) s += `<path class="grid" d="M${L} ${Y(v)}h${W}"/>` + el(short(v), L - 5, Y(v) + 4, "end", "tick");
    for (const v of ticks(x0, x1, 9)) s += `<path class="grid" d="M${X(v)} ${T}v${H}"/>` + el(short(v), X(v), T + H + 15, "middle", "tick");
    s += `<path class="zero" d="M${L} ${Y(0)}h${W}"/>`;
    ["drive rising", "drive falling"].forEach((label, k) => {
      const points = c.x[k].map((x, i) => `${X(x)},${Y(c.y[r][k][i])}`).join(" ");
      s += `<polyline class="c${k}" data-label="${label}" points="${points}"/>`;
      s += `<path class="c${k}" d="M${L + 150 * k} 11h22"/>` + el(label, L + 27 + 150 * k, 15, "start", "label");
    });
    s += el("measured minus model (nm)", 0, 0, "middle", "label").replace("<text", `<text transform="translate(13 ${T + H / 2}) rotate(-90)"`);
    svg.innerHTML = s + el("drive (V)", L + W / 2, T + H + 36, "middle", "label") + "</g>";
    const title = el("", L, T - 9, "start", "title");
    svg.insertAdjacentHTML("beforeend", title);
    svg.lastElementChild.textContent = `${c.name}, ${data.rungs[r]}`; // names are text, never markup
  };
  [rung, condition, fixed].forEach((e) => e.addEventListener("change", draw));
  draw();
}
