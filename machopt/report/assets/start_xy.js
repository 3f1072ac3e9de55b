const DATA = JSON.parse(document.getElementById("data").textContent);
for (const spec of DATA.xy) { const host = document.getElementById(spec.id); if (host) xyChart(host, spec); }
