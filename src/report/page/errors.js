// First of all scripts: gathers what goes wrong, so that a test (and a bug report) can read it from the document.
"use strict";
window.pageErrors = [];
(() => {
	const note = (text) => {
		pageErrors.push(String(text));
		document.documentElement.dataset.errors = JSON.stringify(pageErrors);
	};
	addEventListener("error", (event) => note(event.message || "error"));
	addEventListener("unhandledrejection", (event) => note(event.reason));
	document.addEventListener("securitypolicyviolation", (event) => note("blocked: " + event.violatedDirective + " " + event.blockedURI));
	const error = console.error;
	console.error = (...parts) => {
		note(parts.join(" "));
		error.apply(console, parts);
	};
	document.documentElement.classList.add("scripted");
})();
