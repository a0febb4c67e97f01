// The comparison's 3D view: every reconstruction's points and cameras in the frame of the first.
"use strict";

class CompareView extends SceneView {
	addBackground() {
		this.background = new THREE.Group();
		this.scene.add(this.background);
		this.sides = this.data.sides.map((side) => this.addSide(side));
	}

	/** Each side has its own cameras; there is no moment to show. */
	addCamera() {
		this.cameraGroup = new THREE.Group();
	}

	show() {}

	addSide({ points: { positions, colours, reach, count }, cameras, colour }) {
		const packed = new Uint16Array(bytesOf(positions).buffer);
		const places = Float32Array.from(packed, (v) => (v / 65535 * 2 - 1) * reach);
		const cloud = this.cloud(places, bytesOf(colours), { size: count > 20000 ? 0.055 : 0.075, own: colour, ownShare: 0.5, parent: this.background });
		const group = new THREE.Group();
		const sure = cameras.filter(({ lost }) => !lost);
		group.add(this.line(sure.flatMap(({ pose, tangent }) => this.edges(pose, tangent)), { colour, width: 1.6 }));
		const path = sure.slice(1).flatMap(({ pose }, k) => [...sure[k].pose.slice(0, 3), ...pose.slice(0, 3)]);
		if (path.length) group.add(this.line(path, { colour, width: 1.2, opacity: 0.5 }));
		const lost = cameras.filter((camera) => camera.lost);
		if (lost.length) group.add(this.line(lost.flatMap(({ pose, tangent }) => this.edges(pose, tangent)), { colour, width: 1.6, dashed: true }));
		this.scene.add(group);
		return { cloud, group };
	}

	setPart(side, part, visible) {
		this.sides[side][part].visible = visible;
		this.draw();
	}

	/** How much of a point's colour is its reconstruction's own. */
	setTint(share) {
		for (const { cloud } of this.sides) cloud.material.uniforms.ownShare.value = share;
		this.draw();
	}
}

(() => {
	const find = (id) => document.getElementById(id);
	const root = document.documentElement;
	const settings = new URLSearchParams(location.hash.slice(1));
	let view = null;

	const setTheme = (theme) => {
		root.dataset.theme = theme;
		view?.recolour();
	};
	const isDark = () => (root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches);
	if (settings.has("theme")) root.dataset.theme = settings.get("theme");
	find("theme").addEventListener("click", () => setTheme(isDark() ? "light" : "dark"));
	matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => view?.recolour());

	const fill = (on) => {
		find("stage").classList.toggle("full", on);
		find("full").setAttribute("aria-pressed", on);
		find("full").textContent = on ? "Close" : "Full";
		view?.resize();
	};
	const start = () => {
		const text = find("scene-data");
		if (!text) return "none";
		if (!hasWebgl()) {
			find("fallback").hidden = false;
			return "none";
		}
		const data = { ...JSON.parse(text.textContent), objects: [], frames: [], tangent: [0.5, 0.3] };
		find("canvas").hidden = false;
		view = new CompareView(find("canvas"), find("viewport"), data, () => null);
		const { one, unit } = find("grid-size").dataset;
		find("grid-size").textContent = `${view.gridLength} ${Number(view.gridLength) === 1 ? one : unit}`;
		for (const button of document.querySelectorAll("[data-view]")) button.addEventListener("click", () => view.look(button.dataset.view));
		view.onMode = (mode) => document.querySelectorAll("[data-view]").forEach((button) => button.setAttribute("aria-pressed", button.dataset.view === mode));
		for (const box of document.querySelectorAll("[data-part]")) {
			box.addEventListener("change", () => view.setPart(Number(box.dataset.side), box.dataset.part, box.checked));
		}
		find("show-grid").addEventListener("change", (event) => view.setLayer("grid", event.target.checked));
		find("size").addEventListener("input", (event) => view.setPointSize(Number(event.target.value)));
		find("tint").addEventListener("input", (event) => view.setTint(Number(event.target.value)));
		find("full").addEventListener("click", () => fill(!find("stage").classList.contains("full")));
		addEventListener("keydown", (event) => event.key === "Escape" && find("stage").classList.contains("full") && fill(false));
		view.look(settings.get("view") ?? "home");
		return "webgl";
	};
	root.dataset.renderer = start();
})();
