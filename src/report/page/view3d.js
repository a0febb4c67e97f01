// The 3D view, on three.js (global THREE). Its frame: y up, x along the drive, z towards the viewer; see src/report/view.rs.
"use strict";

/** Bytes of a base64 string. */
const bytesOf = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

const POINT_VERTEX = `
attribute vec4 tint;
uniform float size, pixels, least;
uniform vec3 ground, own;
uniform float groundShare, ownShare;
varying vec3 colour;
void main() {
	vec4 at = modelViewMatrix * vec4(position, 1.0);
	colour = mix(mix(tint.rgb, ground, groundShare * tint.a), own, ownShare);
	gl_Position = projectionMatrix * at;
	gl_PointSize = clamp(size * pixels / max(-at.z, 1e-3), least, 48.0);
}`;
const POINT_FRAGMENT = `
varying vec3 colour;
void main() {
	vec2 d = gl_PointCoord - 0.5;
	if (dot(d, d) > 0.25) discard;
	gl_FragColor = vec4(colour, 1.0);
}`;
const GRID_VERTEX = `
varying vec2 at;
void main() {
	at = position.xz;
	gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;
const GRID_FRAGMENT = `
uniform vec3 colour;
uniform float reach;
varying vec2 at;
void main() {
	gl_FragColor = vec4(colour, 0.30 * (1.0 - smoothstep(0.25, 1.0, length(at) / reach)));
}`;

/** Whether the browser can draw it. */
const hasWebgl = () => {
	try {
		return Boolean(document.createElement("canvas").getContext("webgl2"));
	} catch {
		return false;
	}
};

class SceneView {
	/** `data` as packed by Rust; `picture` has the canvas with the current picture, and `has(index)`: whether a frame has one. */
	constructor(canvas, viewport, data, picture) {
		Object.assign(this, { canvas, viewport, data, picture, index: 0, mode: "home", pointSize: 1, layers: {}, hidden: new Set(), onMode: () => {}, onResize: () => {} });
		THREE.ColorManagement.enabled = false;
		this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
		this.renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
		this.scene = new THREE.Scene();
		this.camera = new THREE.PerspectiveCamera(42, 1, 0.02, 4000);
		this.controls = new THREE.OrbitControls(this.camera, canvas);
		this.controls.zoomToCursor = true;
		this.controls.maxDistance = 900;
		this.controls.minDistance = 0.2;
		this.lines = [];
		this.clouds = [];
		this.addBackground();
		this.addGrid();
		this.addCamera();
		this.addCameras();
		this.objects = data.objects.map((object) => this.addObject(object));
		this.recolour();
		this.controls.addEventListener("start", () => this.setMode("free"));
		this.controls.addEventListener("change", () => this.draw());
		canvas.addEventListener("dblclick", (event) => this.center(event));
		canvas.addEventListener("webglcontextrestored", () => this.draw());
		new ResizeObserver(() => this.resize()).observe(viewport);
		this.resize();
		this.look("home");
	}

	// ---- building

	cloud(positions, tints, { size, ownShare = 0, own = "#000", parent = this.scene }) {
		const geometry = new THREE.BufferGeometry();
		geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
		geometry.setAttribute("tint", new THREE.BufferAttribute(tints, 4, true));
		const uniforms = {
			size: { value: size }, pixels: { value: 1 }, least: { value: 1 }, ground: { value: new THREE.Color() },
			groundShare: { value: 0.42 }, own: { value: new THREE.Color(own) }, ownShare: { value: ownShare },
		};
		const material = new THREE.ShaderMaterial({ uniforms, vertexShader: POINT_VERTEX, fragmentShader: POINT_FRAGMENT });
		const points = new THREE.Points(geometry, material);
		points.frustumCulled = false;
		points.userData.size = size;
		parent.add(points);
		this.clouds.push(points);
		return points;
	}

	line(segments, { colour, width, dashed = false, dash = 0.32, gap = 0.26, opacity = 1, above = false }) {
		const geometry = new THREE.LineSegmentsGeometry();
		geometry.setPositions(segments);
		const material = new THREE.LineMaterial({ color: colour, linewidth: width, dashed, dashSize: dash, gapSize: gap, transparent: above || opacity < 1, opacity, depthTest: !above });
		const line = new THREE.LineSegments2(geometry, material);
		line.computeLineDistances();
		line.frustumCulled = false;
		line.renderOrder = above ? 2 : 0;
		this.lines.push(line);
		return line;
	}

	/** Consecutive places as segments, in two lists: neighbours in time, and bridges over gaps. */
	segments(places) {
		const near = [], gaps = [];
		for (let k = 1; k < places.length; k++) {
			const [i, a] = places[k - 1], [j, b] = places[k];
			(j - i === 1 ? near : gaps).push(...a, ...b);
		}
		return { near, gaps };
	}

	addPath(group, places, style) {
		const { near, gaps } = this.segments(places);
		if (near.length) group.add(this.line(near, style));
		if (gaps.length) group.add(this.line(gaps, { ...style, dashed: true, opacity: 0.45, width: Math.max(1.5, style.width * 0.6) }));
	}

	/** Head of an arrow at the end of a path, in the direction of travel; none where the path is shorter. */
	addArrow(group, places, style) {
		const length = 0.035 * this.data.radius, [x, y, z] = places.at(-1);
		const from = places.findLast(([a, , c]) => Math.hypot(x - a, z - c) >= length);
		if (!from) return;
		const back = Math.atan2(from[2] - z, from[0] - x);
		const stroke = (turn) => [x, y, z, x + length * Math.cos(back + turn), y, z + length * Math.sin(back + turn)];
		group.add(this.line([...stroke(0.45), ...stroke(-0.45)], { ...style, dashed: false }));
	}

	addBackground() {
		const { positions, colours, reach, count } = this.data.points;
		const packed = new Uint16Array(bytesOf(positions).buffer);
		const places = Float32Array.from(packed, (v) => (v / 65535 * 2 - 1) * reach);
		this.background = this.cloud(places, bytesOf(colours), { size: count > 20000 ? 0.055 : 0.075 });
	}

	addGrid() {
		const { radius, scale, ground } = this.data;
		const rough = radius / 5 / scale;
		const power = 10 ** Math.floor(Math.log10(rough));
		const length = [1, 2, 5, 10].map((m) => m * power).find((l) => l >= rough);
		const step = length * scale, half = Math.ceil(3.2 * radius / step), reach = half * step;
		this.gridLength = Number(length.toPrecision(6));
		const corners = [];
		for (let k = -half; k <= half; k++) {
			// Pieces, since the fade is linear along each.
			for (let m = -half; m < half; m++) {
				corners.push(k * step, 0, m * step, k * step, 0, (m + 1) * step, m * step, 0, k * step, (m + 1) * step, 0, k * step);
			}
		}
		const geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.Float32BufferAttribute(corners, 3));
		const uniforms = { colour: { value: new THREE.Color() }, reach: { value: reach } };
		const material = new THREE.ShaderMaterial({ uniforms, vertexShader: GRID_VERTEX, fragmentShader: GRID_FRAGMENT, transparent: true, depthWrite: false });
		this.grid = new THREE.LineSegments(geometry, material);
		this.grid.position.y = ground;
		this.scene.add(this.grid);
	}

	addCamera() {
		const [tx, ty] = this.data.tangent;
		const d = 0.085 * this.data.radius / Math.max(tx, ty);
		const corner = [[-tx, -ty, 1], [tx, -ty, 1], [tx, ty, 1], [-tx, ty, 1]].map((c) => c.map((v) => v * d));
		const edges = corner.flatMap((c, k) => [0, 0, 0, ...c, ...c, ...corner[(k + 1) % 4]]);
		this.cameraGroup = new THREE.Group();
		this.frustum = new THREE.Group();
		this.frustum.add(this.line(edges, { colour: "#fff", width: 1.6 }));
		const geometry = new THREE.BufferGeometry();
		geometry.setAttribute("position", new THREE.Float32BufferAttribute(corner.flat(), 3));
		geometry.setAttribute("uv", new THREE.Float32BufferAttribute([0, 1, 1, 1, 1, 0, 0, 0], 2));
		geometry.setIndex([0, 1, 2, 0, 2, 3]);
		this.texture = new THREE.Texture(this.picture.canvas);
		this.texture.generateMipmaps = false;
		this.texture.minFilter = THREE.LinearFilter;
		const material = new THREE.MeshBasicMaterial({ map: this.texture, side: THREE.DoubleSide, transparent: true, opacity: 0.92 });
		this.screen = new THREE.Mesh(geometry, material);
		this.screen.visible = false;
		this.frustum.add(this.screen);
		const places = this.data.frames.flatMap((f, i) => (f.camera ? [[i, f.camera.slice(0, 3)]] : []));
		this.path = new THREE.Group();
		this.addPath(this.path, places, { colour: "#fff", width: 2 });
		this.cameraGroup.add(this.path, this.frustum);
		this.scene.add(this.cameraGroup);
	}

	/** Pyramids of all cameras, so many at most that they can still be told apart. */
	addCameras() {
		const known = this.data.frames.filter(({ camera }) => camera), step = Math.ceil(known.length / 300);
		const shown = known.filter((_, k) => k % step === 0);
		const edges = shown.flatMap(({ camera, tangent }) => this.edges(camera, tangent ?? this.data.tangent));
		this.allCameras = new THREE.Group();
		if (edges.length) this.allCameras.add(this.line(edges, { colour: "#fff", width: 1.2, opacity: 0.8 }));
		this.scene.add(this.allCameras);
	}

	/** The edges of a camera's pyramid, as segments. */
	edges(pose, [tx, ty]) {
		const d = 0.035 * this.data.radius / Math.max(tx, ty);
		const turn = new THREE.Quaternion(pose[4], pose[5], pose[6], pose[3]);
		const at = new THREE.Vector3().fromArray(pose);
		const corner = [[-tx, -ty], [tx, -ty], [tx, ty], [-tx, ty]].map(([x, y]) => new THREE.Vector3(x * d, y * d, d).applyQuaternion(turn).add(at).toArray());
		return corner.flatMap((c, k) => [...at.toArray(), ...c, ...c, ...corner[(k + 1) % 4]]);
	}

	addObject(object) {
		const group = new THREE.Group();
		const body = new THREE.Group();
		const floats = new Float32Array(bytesOf(object.positions).buffer);
		const rgb = bytesOf(object.colours);
		const tints = new Uint8Array(object.count * 4);
		for (let k = 0; k < object.count; k++) tints.set(rgb.subarray(3 * k, 3 * k + 3), 4 * k);
		if (object.count) this.cloud(floats, tints, { size: 0.06, own: object.colour, ownShare: 0.55, parent: body });
		if (object.size) body.add(this.line(this.box(object.size), { colour: object.colour, width: 2.2 }));
		body.matrixAutoUpdate = false;
		group.add(body);
		const marker = this.cloud(new Float32Array(3), new Uint8Array(4), { size: 0.2, own: object.colour, ownShare: 1, parent: group });
		marker.userData.least = 9;
		this.addPath(group, object.poses.map(([i, at]) => [i, at]), this.pathStyle(object));
		if (object.poses.length) this.addArrow(group, object.poses.map(([, at]) => at), this.pathStyle(object));
		this.scene.add(group);
		return { group, body, marker, poses: new Map(object.poses.map(([i, at, placement]) => [i, { at, placement }])) };
	}

	/** The edges of a box on the ground around the origin, as segments. */
	box([length, height, width]) {
		const corners = [[1, 1], [1, -1], [-1, -1], [-1, 1]].map(([x, z]) => [x * length / 2, z * width / 2]);
		const at = (k, y) => [corners[k % 4][0], y, corners[k % 4][1]];
		return [0, 1, 2, 3].flatMap((k) => [...at(k, 0), ...at(k + 1, 0), ...at(k, height), ...at(k + 1, height), ...at(k, 0), ...at(k, height)]);
	}

	/** Solid; dashed if rejected; dotted for a ground track. */
	pathStyle({ colour, degenerate, ground }) {
		const style = { colour, width: 3.5, dashed: degenerate || ground, above: true };
		return ground ? { ...style, dash: 0.07, gap: 0.14 } : style;
	}

	// ---- state

	/** Takes the page's colours: after a change of theme. */
	recolour() {
		const style = getComputedStyle(document.documentElement);
		const colour = (name) => new THREE.Color(style.getPropertyValue(name).trim());
		this.renderer.setClearColor(colour("--view"));
		this.grid.material.uniforms.colour.value = colour("--soft");
		this.cameraGroup.traverse((part) => part.material?.isLineMaterial && part.material.color.copy(colour("--camera")));
		this.allCameras.traverse((part) => part.material?.isLineMaterial && part.material.color.copy(colour("--soft")));
		for (const cloud of this.clouds) cloud.material.uniforms.ground.value = colour("--ground");
		this.draw();
	}

	/** Shows one frame. */
	show(index) {
		this.index = index;
		const pose = this.data.frames[index].camera;
		this.frustum.visible = Boolean(pose);
		if (pose) {
			this.frustum.position.fromArray(pose);
			this.frustum.quaternion.set(pose[4], pose[5], pose[6], pose[3]);
		}
		this.screen.visible = this.picture.has(index);
		for (const object of this.objects) {
			const found = object.poses.get(index);
			object.body.visible = object.marker.visible = Boolean(found);
			if (!found) continue;
			const [s, w, x, y, z, ...translation] = found.placement;
			object.body.matrix.compose(new THREE.Vector3(...translation), new THREE.Quaternion(x, y, z, w), new THREE.Vector3(s, s, s));
			object.body.matrixWorldNeedsUpdate = true;
			object.marker.position.fromArray(found.at);
			object.marker.visible = !object.body.children.length;
		}
		if (this.mode === "follow" || this.mode === "camera") this.look(this.mode);
		this.draw();
	}

	/** Takes the current picture anew. */
	repaint() {
		if (this.painted !== this.picture.canvas.width) {
			// Textures keep their first size.
			this.texture.dispose();
			this.painted = this.picture.canvas.width;
		}
		this.texture.needsUpdate = true;
		this.draw();
	}

	/** Shows what layers and view leave visible: through the camera, the paths of the vehicles in the picture alone. */
	arrange() {
		this.background.visible = this.layers.background !== false && !this.inside;
		this.grid.visible = this.layers.grid !== false && !this.inside;
		this.allCameras.visible = this.layers.cameras !== false && !this.inside;
		this.data.objects.forEach((object, k) => {
			const { group, body, poses } = this.objects[k];
			group.visible = !this.hidden.has(object.id) && (!this.inside || poses.has(this.index));
			for (const part of body.children) part.visible = !this.inside;
		});
	}

	setLayer(name, visible) {
		this.layers[name] = visible;
		if (name === "ground") for (const cloud of this.clouds) cloud.material.uniforms.groundShare.value = visible ? 0.42 : 0;
		if (name === "camera") this.path.visible = visible;
		this.draw();
	}

	setObject(id, visible) {
		this.hidden[visible ? "delete" : "add"](id);
		this.draw();
	}

	setPointSize(factor) {
		this.pointSize = factor;
		this.resize();
	}

	setMode(mode) {
		if (mode === "free" && this.mode === "camera") this.leaveCamera();
		this.mode = mode;
		this.onMode(mode);
	}

	// ---- views

	/** Distance from which a sphere of the scene's radius fills the view. */
	distance() {
		const vertical = THREE.MathUtils.degToRad(this.camera.fov) / 2;
		const horizontal = Math.atan(Math.tan(vertical) * this.camera.aspect);
		return 0.8 * this.data.radius / Math.sin(Math.min(vertical, horizontal));
	}

	place(direction, up = [0, 1, 0]) {
		this.leaveCamera();
		this.camera.up.fromArray(up);
		this.camera.position.fromArray(direction).normalize().multiplyScalar(this.distance());
		this.controls.target.set(0, 0, 0);
		this.controls.update();
	}

	look(view) {
		if (view === "home") this.place([-0.34, 0.62, 1]);
		if (view === "top") this.place([0, 1, 1e-4]);
		if (view === "side") this.place([0, 0.06, 1]);
		if (view === "follow" || view === "camera") this.ride(view);
		this.setMode(view);
		this.draw();
	}

	/** The known camera nearest in time to the current frame. */
	nearestPose() {
		const { frames } = this.data;
		for (let k = 0; k < frames.length; k++) {
			const pose = frames[this.index - k]?.camera ?? frames[this.index + k]?.camera;
			if (pose) return pose;
		}
		return null;
	}

	ride(view) {
		const pose = this.nearestPose();
		if (!pose) return;
		const center = new THREE.Vector3().fromArray(pose);
		const turn = new THREE.Quaternion(pose[4], pose[5], pose[6], pose[3]);
		const axis = (x, y, z) => new THREE.Vector3(x, y, z).applyQuaternion(turn);
		const forward = axis(0, 0, 1);
		const { radius, tangent: [tx, ty] } = this.data;
		this.leaveCamera();
		if (view === "follow") {
			this.camera.up.set(0, 1, 0);
			this.camera.position.copy(center).addScaledVector(forward, -0.42 * radius).addScaledVector(new THREE.Vector3(0, 1, 0), 0.2 * radius);
			this.controls.target.copy(center).addScaledVector(forward, 0.5 * radius);
			this.controls.update();
			return;
		}
		// Through the camera: its own angle of view, the picture far behind the points.
		this.camera.fov = 2 * THREE.MathUtils.radToDeg(Math.atan(Math.max(ty, tx / this.camera.aspect)));
		this.camera.up.copy(axis(0, -1, 0));
		this.camera.position.copy(center);
		this.controls.target.copy(center).addScaledVector(forward, 0.5 * radius);
		this.camera.lookAt(this.controls.target);
		this.camera.updateProjectionMatrix();
		// At half the distance up to which is drawn, whatever the angle of view.
		this.frustum.scale.setScalar(2000 * Math.max(tx, ty) / (0.085 * radius));
		this.screen.renderOrder = -1;
		this.screen.material.depthWrite = false;
		this.screen.material.opacity = 1;
		this.inside = true;
	}

	leaveCamera() {
		if (!this.inside) return;
		this.inside = false;
		this.camera.fov = 42;
		this.camera.up.set(0, 1, 0);
		this.camera.updateProjectionMatrix();
		this.frustum.scale.setScalar(1);
		this.screen.renderOrder = 0;
		this.screen.material.depthWrite = true;
		this.screen.material.opacity = 0.92;
	}

	/** A double click makes the point under the pointer the centre of turning. */
	center(event) {
		const box = this.canvas.getBoundingClientRect();
		const at = new THREE.Vector2((event.clientX - box.left) / box.width * 2 - 1, 1 - (event.clientY - box.top) / box.height * 2);
		const ray = new THREE.Raycaster();
		ray.params.Points.threshold = 0.12;
		ray.setFromCamera(at, this.camera);
		const hit = ray.intersectObject(this.background).sort((a, b) => a.distanceToRay - b.distanceToRay)[0];
		if (!hit) return;
		this.setMode("free");
		this.controls.target.copy(hit.point);
		this.controls.update();
		this.draw();
	}

	// ---- drawing

	resize() {
		const { clientWidth: width, clientHeight: height } = this.viewport;
		if (!width || !height) return;
		const ratio = Math.min(window.devicePixelRatio || 1, 2);
		this.renderer.setPixelRatio(ratio);
		this.renderer.setSize(width, height, false);
		this.camera.aspect = width / height;
		this.camera.updateProjectionMatrix();
		for (const line of this.lines) line.material.resolution.set(width, height);
		this.ratio = ratio;
		if (this.mode !== "free") this.look(this.mode);
		this.onResize(width, height);
		this.draw();
	}

	draw() {
		if (this.waiting) return;
		this.waiting = true;
		requestAnimationFrame(() => {
			this.waiting = false;
			this.render();
		});
	}

	render() {
		this.arrange();
		const pixels = this.viewport.clientHeight * this.ratio / (2 * Math.tan(THREE.MathUtils.degToRad(this.camera.fov) / 2));
		for (const cloud of this.clouds) {
			const { uniforms } = cloud.material;
			uniforms.pixels.value = pixels;
			uniforms.least.value = (cloud.userData.least ?? 1.4 * Math.sqrt(this.pointSize)) * this.ratio;
			// The body's points are given in its own unit, sizes in the view's: the shader sees only the view's.
			uniforms.size.value = cloud.userData.size * this.pointSize;
		}
		this.renderer.render(this.scene, this.camera);
		this.onFrame?.();
	}
}
