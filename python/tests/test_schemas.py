"""The JSON Schemas of `tractrix schema`, by the package jsonschema, against a real output folder.

TRACTRIX_OUTPUT names the folder, TRACTRIX the program; scripts/test sets both.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import tempfile
import unittest
from pathlib import Path
from typing import Any

FOLDER, PROGRAM = os.environ.get("TRACTRIX_OUTPUT"), os.environ.get("TRACTRIX")
HAS_VALIDATOR = importlib.util.find_spec("jsonschema") is not None
# Schemas of files, and of what commands print.
FILES = {
    "trajectories": "trajectories.json",
    "tracks": "tracks.json",
    "ground": "ground.json",
    "run": "run.json",
    "evaluation": "evaluation.json",
}


def extended(schema: Any) -> set[str]:
    """References that a schema adds properties to: their own schemas must stay open."""
    if isinstance(schema, list):
        return set().union(*map(extended, schema))
    if not isinstance(schema, dict):
        return set()
    own = {schema["$ref"]} if "$ref" in schema and "properties" in schema else set()
    return own.union(*map(extended, schema.values()))


def closed(schema: Any, open_ones: set[str], path: str = "#") -> Any:
    """The same schema without keys that it does not name: a key that the program writes has its description."""
    if isinstance(schema, list):
        return [closed(part, open_ones, f"{path}/{k}") for k, part in enumerate(schema)]
    if not isinstance(schema, dict):
        return schema
    parts = {key: closed(part, open_ones, f"{path}/{key}") for key, part in schema.items()}
    if isinstance(parts.get("properties"), dict) and parts.get("type") == "object" and path not in open_ones:
        parts.setdefault("unevaluatedProperties", False)
    return parts


@unittest.skipUnless(FOLDER and PROGRAM, "TRACTRIX_OUTPUT and TRACTRIX name no output folder and program")
@unittest.skipUnless(HAS_VALIDATOR, "jsonschema is not installed")
class Schemas(unittest.TestCase):
    def output(self, *arguments: str) -> Any:
        command = [PROGRAM or "", *arguments]
        return json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)

    def check(self, name: str, document: Any) -> None:
        import jsonschema

        schema = self.output("schema", name)
        jsonschema.Draft202012Validator.check_schema(schema)
        errors = list(jsonschema.Draft202012Validator(closed(schema, extended(schema))).iter_errors(document))
        self.assertEqual([f"{error.json_path}: {error.message[:300]}" for error in errors], [], name)

    def test_files_of_a_run(self) -> None:
        checked = 0
        for name, file in FILES.items():
            path = Path(FOLDER or "") / file
            if path.is_file():
                self.check(name, json.loads(path.read_text(encoding="utf-8")))
                checked += 1
        self.assertGreaterEqual(checked, 4)

    def test_output_of_commands(self) -> None:
        run = json.loads((Path(FOLDER or "") / "run.json").read_text(encoding="utf-8"))
        # The same command again reuses all stages and prints the result.
        self.check("run-output", self.output(*[part for part in run["arguments"][1:] if part != "--json"], "--json"))
        self.check("summary", self.output("summary", FOLDER or "", "--json"))
        with tempfile.TemporaryDirectory() as folder:
            gates = Path(folder) / "gates.geojson"
            corners = [[-1e3, -1e3], [1e3, -1e3], [1e3, 1e3], [-1e3, 1e3], [-1e3, -1e3]]
            shapes = [("LineString", corners[:3:2]), ("LineString", corners[1:4:2]), ("Polygon", [corners])]
            features = [
                {"type": "Feature", "properties": {}, "geometry": {"type": kind, "coordinates": at}}
                for kind, at in shapes
            ]
            gates.write_text(json.dumps({"type": "FeatureCollection", "features": features}), encoding="utf-8")
            found = self.output("analyse", FOLDER or "", "--gates", str(gates), "--json")
        self.assertTrue(found["visits"])
        self.check("analyse", found)

    def test_a_wrong_document_is_found(self) -> None:
        with self.assertRaises(AssertionError):
            self.check("tracks", {"version": 1, "objects": [{"id": "one"}]})


if __name__ == "__main__":
    unittest.main()
