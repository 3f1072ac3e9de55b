const scene = DATA.view.scene, k = [1e6, 1e6, 1e6, 1e6, 1e6, 1e6];
found.poses = GIVEN.q.map(q => FK.tool(scene, FK.motions(scene, q)));
found.compliance = GIVEN.q.map(q => FK.compliance(scene, FK.motions(scene, q), k));
found.eigenvalues = found.compliance.map(FK.eigenvalues);
