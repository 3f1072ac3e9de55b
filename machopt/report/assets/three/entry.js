// What the pages use of three.js; everything else is shaken off. Rebuild in an empty folder beside a copy of this file:
//   npm install three@0.187.0 esbuild@0.28.2 && npx esbuild entry.js --bundle --minify --format=iife --global-name=THREE \
//     --legal-comments=none --outfile=three.min.js
export {
  BufferAttribute, BufferGeometry, Color, CylinderGeometry, DirectionalLight, GridHelper, Group,
  HemisphereLight, Line, LineBasicMaterial, LineSegments, Matrix4, Mesh, MeshBasicMaterial, MeshLambertMaterial, PerspectiveCamera,
  Scene, SphereGeometry, Vector3, WebGLRenderer,
} from "three";
export { LineMaterial } from "three/examples/jsm/lines/LineMaterial.js";
export { LineSegments2 } from "three/examples/jsm/lines/LineSegments2.js";
export { LineSegmentsGeometry } from "three/examples/jsm/lines/LineSegmentsGeometry.js";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
