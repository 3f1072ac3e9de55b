const host = document.getElementById("field"), canvas = () => host.querySelector("canvas");
const white = () => { const c = canvas(), d = c.getContext("2d").getImageData(70, 30, c.width - 190, c.height - 90).data; let n = 0; for (let i = 0; i < d.length; i += 4) n += d[i] > 250 && d[i + 1] > 250 && d[i + 2] > 250; return n; };
const side = () => host.querySelector(".side").textContent, hover = (kind, x, y) => { const o = host.querySelector(".u-over"); send({ over: o }, kind, x, y); };
found.best = side();
found.arm = host.querySelectorAll(".over path").length + host.querySelectorAll(".over circle").length;
const lines = white();
host.querySelector("input[type=checkbox]").click();
await wait(100);
found.lines = lines - white();
hover("mousemove", 0.95, 0.95);
found.under = side();
found.tip = document.querySelector(".tip").textContent;
for (const kind of ["mousedown", "mouseup", "click"]) hover(kind, 0.95, 0.95);
hover("mouseleave", 0.95, 0.95);
found.kept = side();
const pick = host.querySelector("select");
pick.value = "deflection"; pick.onchange();
await wait(100);
found.here = host.querySelector(".numbers .here").textContent;
const scale = host.querySelectorAll("select")[1];
for (const value of ["a", "l"]) { scale.value = value; scale.onchange(); await wait(50); }
const slide = host.querySelector("input[type=range]");
if (slide) { slide.value = 0; slide.oninput(); await wait(50); found.level = slide.nextSibling.textContent; }
