// What the report's 3D view uses of three.js, as one global: `THREE`.
export {
	BufferAttribute, BufferGeometry, Color, ColorManagement, DoubleSide, Float32BufferAttribute, Group, LinearFilter,
	LineSegments, LinearSRGBColorSpace, MathUtils, Mesh, MeshBasicMaterial, PerspectiveCamera, Points, Quaternion,
	Raycaster, Scene, ShaderMaterial, Texture, Vector2, Vector3, WebGLRenderer,
} from 'three';
export { OrbitControls } from 'three/addons/controls/OrbitControls.js';
export { LineSegments2 } from 'three/addons/lines/LineSegments2.js';
export { LineSegmentsGeometry } from 'three/addons/lines/LineSegmentsGeometry.js';
export { LineMaterial } from 'three/addons/lines/LineMaterial.js';
