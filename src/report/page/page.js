// The page's clock: slider, playing, strip, charts and the 3D view all show the same moment.
"use strict";
(() => {
	const find = (id) => document.getElementById(id);
	const read = (id) => (find(id) ? JSON.parse(find(id).textContent) : null);
	const root = document.documentElement;
	const data = read("scene-data"), charts = read("chart-data") ?? [], { start, end, seconds } = read("clock-data");
	const shots = [...document.querySelectorAll(".shot")].map((element) => ({
		element, time: Number(element.dataset.time), image: element.querySelector("img"), labels: element.querySelectorAll("b"),
	}));
	const frames = data ? data.frames : shots.map(({ time }, k) => ({ time, frame: k, camera: null }));
	const times = frames.map((f) => f.time);
	const nearest = (list, time) => list.reduce((best, t, k) => (Math.abs(t - time) < Math.abs(list[best] - time) ? k : best), 0);
	const shotOf = times.map((time) => nearest(shots.map((s) => s.time), time));
	/** Half a step between two pictures, a little more: what is farther away does not belong to a moment. */
	const reachOf = (list) => (list.length > 1 ? (list.at(-1) - list[0]) / (list.length - 1) * 0.75 : Infinity);
	// Without a rate nobody knows how fast it was: ten frames per second can be followed.
	const pace = seconds ? 1 : 10;
	const settings = new URLSearchParams(location.hash.slice(1));
	const UNITS = { "km/h": 1, "m/s": 1 / 3.6, "mph": 1 / 1.609344 };
	let index = 0, playing = null, view = null, unit = "km/h";

	// ---- the picture of the moment: of the film where the browser plays it, else of the strip

	const canvas = find("now-picture");
	let film = null;
	/** Draws the current picture, and has it shown in the 3D view. */
	const paint = (source, width, height) => {
		if (!canvas || !width) return;
		if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
		canvas.getContext("2d").drawImage(source, 0, 0, width, height);
		view?.repaint();
	};
	/** Loads the film; `null` if there is none, or if it cannot be played. */
	const openFilm = () => new Promise((resolve) => {
		const packed = canvas && read("film-data");
		const video = document.createElement("video");
		if (!packed || !video.canPlayType('video/mp4; codecs="avc1.42E01E"')) return resolve(null);
		const bytes = Uint8Array.from(atob(packed.mp4), (c) => c.charCodeAt(0));
		Object.assign(video, { muted: true, playsInline: true, preload: "auto" });
		video.addEventListener("error", () => resolve(null));
		video.addEventListener("loadeddata", () => resolve(new Film(video, packed)), { once: true });
		setTimeout(resolve, 4000, null);
		video.src = URL.createObjectURL(new Blob([bytes], { type: "video/mp4" }));
	});
	class Film {
		constructor(video, { rate, times: at, labels, width, height }) {
			Object.assign(this, { video, rate, labels, width, height, wanted: 0, of: times.map((time) => nearest(at, time)) });
			const reach = reachOf(at);
			this.covers = times.map((time, k) => Math.abs(at[this.of[k]] - time) <= reach);
			video.addEventListener("seeked", () => {
				paint(video, width, height);
				if (this.shown !== this.wanted) this.seek();
			});
		}
		show(index) {
			this.wanted = this.of[index];
			if (!this.video.seeking) this.seek();
		}
		seek() {
			this.shown = this.wanted;
			this.video.currentTime = (this.shown + 0.5) / this.rate;
		}
		labelsAt(index) {
			return this.labels[this.of[index]].map(({ id, colour, left, top }) => {
				const label = document.createElement("b");
				label.textContent = id;
				label.style.cssText = `left:${left}%;top:${top}%;--c:${colour}`;
				return label;
			});
		}
	}
	const shotTimes = shots.map((shot) => shot.time), shotReach = reachOf(shotTimes);
	const hasPicture = (index) => (film ? film.covers[index] : shots.length > 0 && Math.abs(shotTimes[shotOf[index]] - times[index]) <= shotReach);
	const showPicture = () => {
		if (film) return film.show(index);
		const image = shots[shotOf[index]]?.image;
		if (image) paint(image, image.naturalWidth, image.naturalHeight);
	};
	const labels = () => (film ? film.labelsAt(index) : [...(shots[shotOf[index]]?.labels ?? [])].map((label) => label.cloneNode(true)));

	// ---- the moment

	const cursors = document.querySelectorAll(".cursor");
	const handles = [...document.querySelectorAll(".cursor[data-label]")];
	// Nothing but zeros has no sign.
	const format = (v, decimals) => v.toFixed(decimals).replace(/^-(?=[0.]*$)/, "").replace("-", "−");
	const speedChart = [...document.querySelectorAll("[data-chart]")].find((figure) => figure.querySelector("h3 small").textContent === "km/h");
	const outputs = charts.map((chart, c) => chart.lines.map((line, l) => ({
		times: line.samples.map((s) => s[0]), values: line.samples.map((s) => s[1]), decimals: chart.decimals, isSpeed: speedChart?.dataset.chart === String(c),
		element: document.querySelector(`[data-chart="${c}"] [data-line="${l}"]`),
	}))).flat();
	/** A frame's moment, as it is shown and as it is read aloud. */
	const stamp = (k) => (seconds ? `${times[k].toFixed(2)} s · frame ${frames[k].frame}` : `frame ${frames[k].frame}`);
	const spoken = (k) => (seconds ? `${times[k].toFixed(2)} seconds, frame ${frames[k].frame}` : `frame ${frames[k].frame}`);
	const step = times.length > 1 ? (times.at(-1) - times[0]) / (times.length - 1) : 1;

	const readCharts = (time) => {
		for (const { times: at, values, decimals, isSpeed, element } of outputs) {
			const factor = isSpeed ? UNITS[unit] : 1;
			const k = nearest(at, time);
			const reach = Math.max(step, at.length > 1 ? (at.at(-1) - at[0]) / (at.length - 1) : 0) * 0.8;
			element.textContent = at.length && Math.abs(at[k] - time) <= reach ? format(factor * values[k], decimals) : "–";
		}
	};

	/** A text with speeds in km/h, in the chosen unit; a standard deviation has two digits. */
	const inUnit = (text) => text.replace(/([\d.]+)( ± ([\d.]+))? km\/h/g, (whole, value, _, std) => {
		if (unit === "km/h") return whole;
		const digits = std ? 1 - Math.floor(Math.log10(std * UNITS[unit])) : (value.split(".")[1] ?? "").length + (unit === "m/s" ? 1 : 0);
		const decimals = Math.min(4, Math.max(0, digits));
		const of = (number) => (number * UNITS[unit]).toFixed(decimals);
		return `${of(value)}${std ? ` ± ${of(std)}` : ""} ${unit}`;
	});
	const setUnit = (chosen) => {
		unit = chosen;
		for (const cell of document.querySelectorAll(".vehicles td")) {
			cell.dataset.text ??= cell.textContent;
			if (cell.dataset.text.includes("km/h")) cell.textContent = inUnit(cell.dataset.text);
		}
		speedChart.querySelector("h3 small").textContent = unit;
		for (const tick of speedChart.querySelectorAll(".y-axis span")) {
			tick.dataset.value ??= tick.textContent.replace("−", "-");
			tick.textContent = unit === "km/h" ? tick.dataset.value.replace("-", "−") : format(tick.dataset.value * UNITS[unit], 1);
		}
		show(index);
	};

	/** What the sliders in the charts say: the moment, and what the legend beside them reads. */
	const sayMoment = () => handles.forEach((handle) => {
		const readings = [...(handle.closest(".chart")?.querySelectorAll("[data-line]") ?? [])];
		const values = readings.map((output) => `${output.parentElement.firstChild.nextSibling.textContent.trim()} ${output.textContent}`);
		handle.setAttribute("aria-valuenow", index);
		handle.setAttribute("aria-valuetext", [spoken(index), ...values].join(", "));
	});

	const describe = () => {
		const text = find("now-text");
		if (!text) return;
		showPicture();
		find("now").querySelectorAll("b").forEach((b) => b.remove());
		find("now").querySelector(".picture").append(...labels());
		find("labels").replaceChildren(...labels());
		text.replaceChildren();
		const add = (words, colour, absent) => {
			const span = document.createElement("span");
			if (colour) {
				const dot = document.createElement("i");
				dot.style.setProperty("--c", colour);
				span.append(dot);
			}
			span.classList.toggle("absent", absent);
			span.append(words);
			text.append(span);
		};
		if (!frames[index].camera) add("Camera not registered", null, true);
		for (const object of data?.objects ?? []) {
			const pose = object.poses.find(([i]) => i === index);
			// Speed and distance of a rejected trajectory are not to be read off.
			const reading = object.degenerate ? "rejected" : pose?.[3] && inUnit(pose[3]);
			if (pose) add(reading ? `${object.name}: ${reading}` : object.name, object.colour, false);
		}
	};

	let lastShot = null;
	const markShot = (scroll) => {
		const shot = shots[shotOf[index]]?.element;
		if (!shot || shot === lastShot) return;
		lastShot?.classList.remove("current");
		lastShot?.removeAttribute("aria-current");
		shot.classList.add("current");
		shot.setAttribute("aria-current", "true");
		lastShot = shot;
		const strip = find("strip");
		// Only the strip scrolls, never the page.
		if (scroll) strip.scrollLeft = shot.offsetLeft - strip.offsetLeft - (strip.clientWidth - shot.clientWidth) / 2;
	};

	const show = (wanted, { scroll = true } = {}) => {
		if (!frames.length) return;
		index = Math.max(0, Math.min(frames.length - 1, wanted));
		const time = times[index];
		const percent = end > start ? (time + step / 2 - start) / (end - start) * 100 : 0;
		cursors.forEach((cursor) => (cursor.style.left = `${Math.min(100, percent)}%`));
		if (find("time")) {
			find("time").value = index;
			find("time").setAttribute("aria-valuetext", spoken(index));
			find("clock").textContent = stamp(index);
		}
		readCharts(time);
		sayMoment();
		markShot(scroll);
		if (data) {
			describe();
			view?.show(index);
			movePlan();
		}
	};

	/** Markers of the top view: what print and browsers without WebGL show. */
	const movePlan = () => {
		const placed = (at) => data.turn.map(([a, b]) => (a * at[0] + b * at[2]) * 10);
		const put = (element, at) => element && (at ? element.setAttribute("d", `M${placed(at).join(" ")}h0`) : element.removeAttribute("d"));
		for (const plan of document.querySelectorAll(".plan-live")) {
			put(plan.querySelector(".plan-here"), frames[index].camera);
			for (const object of data.objects) {
				const pose = object.poses.find(([i]) => i === index);
				put(plan.querySelector(`.plan-end[data-object="${object.id}${object.ground ? "-ground" : ""}"]`), pose?.[1]);
			}
		}
	};

	// ---- playing

	const stop = () => {
		playing = null;
		if (!find("play")) return;
		find("play").textContent = "▶";
		find("play").setAttribute("aria-label", "Play");
	};
	const play = () => {
		if (!find("play")) return;
		if (index >= frames.length - 1) show(0);
		const run = (playing = { clock: performance.now(), time: times[index] });
		find("play").textContent = "❚❚";
		find("play").setAttribute("aria-label", "Pause");
		const tick = (now) => {
			if (playing !== run) return;
			run.time += Math.max(0, now - run.clock) / 1000 * pace * Number(find("speed").value);
			run.clock = now;
			let next = index;
			while (next < times.length - 1 && times[next + 1] <= run.time) next++;
			if (next !== index) show(next);
			if (index >= times.length - 1) return stop();
			requestAnimationFrame(tick);
		};
		requestAnimationFrame(tick);
	};
	const toggle = () => (playing ? stop() : play());
	const jump = (time, options) => {
		stop();
		show(nearest(times, time), options);
	};

	// ---- controls

	const fill = (on) => {
		find("stage").classList.toggle("full", on);
		find("full").setAttribute("aria-pressed", on);
		find("full").textContent = on ? "Close" : "Full";
		document.body.style.overflow = on ? "hidden" : "";
		listenToWheel();
	};
	// The wheel belongs to the page until the reader has taken hold of the view.
	const listenToWheel = () => {
		if (!view) return;
		const held = find("viewport").contains(document.activeElement) || find("stage").classList.contains("full");
		view.controls.enableZoom = held || matchMedia("(pointer: coarse)").matches;
		find("canvas").style.touchAction = find("stage").classList.contains("full") ? "none" : "pan-y";
	};

	const keys = {
		" ": toggle, k: toggle, ArrowLeft: () => { stop(); show(index - 1); }, ArrowRight: () => { stop(); show(index + 1); },
		Home: () => { stop(); show(0); }, End: () => { stop(); show(frames.length - 1); },
	};

	const listen = (element) => element.addEventListener("keydown", (event) => {
		if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
		event.preventDefault();
		keys[event.key]();
	});

	/** Charts are sliders over time, for those who have no pointer too. */
	const makeSlider = (handle) => {
		const settings = { tabindex: 0, role: "slider", "aria-label": handle.dataset.label, "aria-valuemin": 0, "aria-valuemax": frames.length - 1 };
		Object.entries(settings).forEach(([name, value]) => handle.setAttribute(name, value));
		listen(handle);
	};

	const connect = () => {
		const stage = find("stage"), viewport = find("viewport");
		find("time").max = frames.length - 1;
		find("time").addEventListener("input", (event) => { stop(); show(Number(event.target.value)); });
		find("play").addEventListener("click", toggle);
		find("full").addEventListener("click", () => fill(!stage.classList.contains("full")));
		listen(viewport);
		addEventListener("keydown", (event) => event.key === "Escape" && stage.classList.contains("full") && fill(false));
		if (!view) return;
		viewport.addEventListener("pointerdown", () => viewport.focus({ preventScroll: true }));
		viewport.addEventListener("focusin", listenToWheel);
		viewport.addEventListener("focusout", () => setTimeout(listenToWheel));
		document.querySelectorAll("[data-view]").forEach((button) => button.addEventListener("click", () => view.look(button.dataset.view)));
		view.onMode = (mode) => {
			stage.dataset.mode = mode;
			if (mode === "camera") find("layers").open = false;
			document.querySelectorAll("[data-view]").forEach((b) => b.setAttribute("aria-pressed", b.dataset.view === mode && mode !== "home"));
		};
		// The picture fills the view as far as its shape allows.
		view.onResize = (width, height) => {
			const [tx, ty] = data.tangent, shape = tx / ty, across = Math.min(width, height * shape);
			Object.assign(find("labels").style, { width: `${across}px`, height: `${across / shape}px` });
		};
		find("labels").hidden = false;
		stage.style.setProperty("--shape", data.tangent[0] / data.tangent[1]);
		view.resize();
		document.querySelectorAll("[data-layer]").forEach((box) => box.addEventListener("change", () => view.setLayer(box.dataset.layer, box.checked)));
		document.querySelectorAll("input[data-object]").forEach((box) => box.addEventListener("change", () => view.setObject(Number(box.dataset.object), box.checked)));
		find("size").addEventListener("input", (event) => view.setPointSize(Number(event.target.value)));
		const unit = find("grid-size").dataset.unit;
		find("grid-size").textContent = `${view.gridLength} ${view.gridLength === 1 ? unit.replace(/s$/, "") : unit}`;
		if (matchMedia("(max-width: 640px)").matches) find("layers").open = false;
		listenToWheel();
	};

	const scrub = (area) => {
		const go = (event) => {
			const box = area.getBoundingClientRect();
			jump(start + (event.clientX - box.left) / box.width * (end - start) - step / 2);
		};
		area.addEventListener("pointerdown", (event) => { area.setPointerCapture(event.pointerId); go(event); });
		area.addEventListener("pointermove", (event) => event.buttons && go(event));
	};

	/** Opens the details of the vehicle that a link of the table leads to. */
	const unfold = () => {
		const target = location.hash.startsWith("#object-") ? find(location.hash.slice(1)) : null;
		if (!target) return;
		target.closest("details").open = true;
		target.scrollIntoView();
	};

	const setTheme = (theme) => {
		root.dataset.theme = theme;
		view?.recolour();
	};
	const isDark = () => (root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches);

	/** The moment to begin with: as many vehicles in place as can be, not quite at the end. */
	const opening = () => {
		if (settings.has("t")) return nearest(times, Number(settings.get("t")));
		const placed = frames.map((f, i) => (f.camera ? 0.5 : 0) + (data?.objects ?? []).filter((o) => o.poses.some(([k]) => k === i)).length);
		const most = Math.max(...placed), goal = 0.6 * frames.length;
		return placed.reduce((best, n, i) => (n === most && (best < 0 || Math.abs(i - goal) < Math.abs(best - goal)) ? i : best), -1);
	};

	const begin = () => {
		if (settings.has("theme")) root.dataset.theme = settings.get("theme");
		find("theme").addEventListener("click", () => setTheme(isDark() ? "light" : "dark"));
		matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => view?.recolour());
		if (data) {
			let problem = hasWebgl() ? null : "No 3D view, since this browser has no WebGL; showing the top view.";
			if (!problem) {
				find("canvas").hidden = false;
				try {
					view = new SceneView(find("canvas"), find("viewport"), data, { canvas, has: hasPicture });
					find("plan").hidden = true;
				} catch (error) {
					problem = `No 3D view (${error.message}); showing the top view.`;
				}
			}
			if (problem) {
				find("canvas").hidden = true;
				find("fallback").hidden = false;
				find("fallback").textContent = problem;
				document.querySelectorAll("[data-view], #layers").forEach((element) => (element.hidden = true));
			}
			connect();
			if (settings.has("full")) fill(true);
			// The film with the paths drawn in opens the page; without it, the scene.
			if (view) view.look(settings.get("view") ?? find("stage").dataset.opens ?? (film && data.objects.length ? "camera" : "home"));
			for (const box of document.querySelectorAll("[data-layer]:not(:checked)")) view?.setLayer(box.dataset.layer, false);
		}
		find("filter")?.addEventListener("change", ({ target }) => document.querySelectorAll("[data-trust]").forEach((row) => {
			row.hidden = Number(row.dataset.trust) > Number(target.value);
		}));
		if (speedChart && find("units")) find("units").hidden = false;
		find("units")?.addEventListener("change", ({ target }) => setUnit(target.value));
		addEventListener("hashchange", unfold);
		unfold();
		shots.forEach(({ element, time }) => element.addEventListener("click", () => jump(time, { scroll: false })));
		document.querySelectorAll(".area:not(.still), .row:not(.axis) .track").forEach(scrub);
		handles.forEach(makeSlider);
		show(opening());
		root.dataset.renderer = view ? "webgl" : data ? "plan" : "none";
		// Two frames later everything is on the screen.
		const ready = () => requestAnimationFrame(() => requestAnimationFrame(() => { root.dataset.ready = "true"; }));
		if (!film?.video.seeking) return ready();
		film.video.addEventListener("seeked", ready, { once: true });
		// A browser that draws no more frames while it waits for the film is ready, too.
		setTimeout(() => { root.dataset.ready = "true"; }, 2000);
	};

	// Pictures first: the frustum carries one.
	Promise.allSettled([openFilm().then((opened) => { film = opened; }), ...shots.map(({ image }) => image.decode())]).then(begin);
})();
