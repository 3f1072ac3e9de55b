const canvas = document.querySelector("#view canvas");
const pixels = async () => {
  await wait(50);
  VIEW.stage.paintNow(); // a busy machine may owe the frame that was asked for
  const flat = document.createElement("canvas");
  flat.width = canvas.width; flat.height = canvas.height;
  const ctx = flat.getContext("2d");
  ctx.drawImage(canvas, 0, 0);
  return ctx.getImageData(0, 0, flat.width, flat.height).data;
};
const changed = (a, b) => { let n = 0; for (let i = 0; i < a.length; i += 4) if (a[i] !== b[i] || a[i + 1] !== b[i + 1] || a[i + 2] !== b[i + 2]) n++; return n; };
const click = (u, x, y) => { for (const kind of ["mousemove", "mousedown", "mouseup", "click"]) send(u, kind, x, y); };
const told = () => document.querySelector("#view .pose-details").textContent;
const start = await pixels(), seen = new Set();
for (let i = 0; i < start.length; i += 4) seen.add(start[i] << 16 | start[i + 1] << 8 | start[i + 2]);
found.colours = seen.size;

const map = of("map"), R = DATA.map.rotations;
click(map, 0.7, 0.5);
const there = await pixels(), place = VIEW.shown;
found.moved = changed(start, there);
found.cell = place.q;
found.wanted = levelled(DATA.view.stations.q).row(place.k * R + place.r);
found.told = told();
click(map, 0.7, 0.35);
found.turned = changed(there, await pixels());
const status = bytes(DATA.map.status), lost = status.indexOf(1);
VIEW.go(VIEW.atCell(Math.floor(lost / R), lost % R));
found.unreachable = told();

const curve = of("c-index");
click(curve, 0.4, 0.5);
await wait(100);
const spec = DATA.charts.find(c => c.id === "c-index");
found.curve = [spec.extra[0].names[curve.posToIdx(0.4 * curve.over.clientWidth)], VIEW.shown.point, PLOTS.filter(u => u.here && u.here.style.display === "block").map(u => parseFloat(u.here.style.left))];
send(curve, "mousemove", 0.5, 0.5);
found.tip = document.querySelector(".tip").textContent;

const slider = document.querySelector("#view .controls input"), at = () => [VIEW.shown.t, of("c-feed").here.style.left];
slider.value = 200; slider.dispatchEvent(new Event("input"));
await wait(50);
const one = at();
slider.value = 700; slider.dispatchEvent(new Event("input"));
await wait(50);
found.slider = [one, at()];

const link = document.querySelector("#points a[data-point]");
link.click();
found.linked = +link.dataset.point;
found.at = told();
found.link = [VIEW.shown.point, link.getAttribute("href")];
found.keyboard = [...document.querySelectorAll("#view canvas, #view button, #view select, #view input")].every(e => e.tabIndex >= 0 && (e.tagName !== "INPUT" || e.labels.length) && (e.tagName !== "BUTTON" || e.textContent));
found.asked = performance.getEntriesByType("resource").length;
