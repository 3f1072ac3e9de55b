found.said = document.querySelector("#view").textContent;
for (const kind of ["mousemove", "mousedown", "mouseup", "click"]) send(of("map"), kind, 0.5, 0.5);
found.told = document.querySelector("#view .pose-details").textContent;
