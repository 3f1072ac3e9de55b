const canvas = document.querySelector("#view canvas"), slider = document.querySelector("#view input");
const pixels = () => {
  VIEW.stage.paintNow();
  const flat = document.createElement("canvas");
  flat.width = canvas.width; flat.height = canvas.height;
  const ctx = flat.getContext("2d");
  ctx.drawImage(canvas, 0, 0);
  return ctx.getImageData(0, 0, flat.width, flat.height).data;
};
const one = pixels(), seen = new Set();
for (let i = 0; i < one.length; i += 4) seen.add(one[i] << 16 | one[i + 1] << 8 | one[i + 2]);
found.colours = seen.size;
slider.value = 2; slider.dispatchEvent(new Event("input"));
const other = pixels();
found.moved = 0;
for (let i = 0; i < one.length; i += 4) if (one[i] !== other[i] || one[i + 1] !== other[i + 1]) found.moved++;
found.told = document.querySelector("#view .pose-details").textContent;
found.shown = VIEW.shown;
