const DATA = JSON.parse(document.getElementById("data").textContent);
for (const spec of DATA.charts) lineChart(document.getElementById(spec.id), spec);
if (DATA.map) heatMap(document.getElementById("map"), DATA.map);
