const scene = DATA.view.scene, k = [1e6, 1e6, 1e6, 1e6, 1e6, 1e6];
found.poses = GIVEN.q.map(q => { const M = FK.motions(scene, q); return FK.after(FK.inverse(FK.part(scene, M)), FK.tool(scene, M)); });
found.compliance = GIVEN.q.map(q => FK.compliance(scene, FK.motions(scene, q), k));
found.eigenvalues = found.compliance.map(FK.eigenvalues);
