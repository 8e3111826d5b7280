"""Reader of MTL files, the materials of OBJ files.

Kd is linear; a texture map_Kd replaces it, as intended by most programs that write both.
Roughness and metallic are read from Pr and Pm; specular (Ks, Ns), opacity (d, Tr) and bump maps are
ignored.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gf_usd.core.errors import InputError
from gf_usd.readers.mesh.data import REPAIR, FileMaterial, Picture, Slot, refuse_pointer
from gf_usd.readers.notes import Notes

# how many tokens follow each option of a map_ statement; -o, -s and -t have one to three numbers
OPTIONS = dict.fromkeys(
    ("-blendu", "-blendv", "-boost", "-texres", "-clamp", "-bm", "-imfchan", "-type", "-cc"), 1
) | {"-mm": 2}
NUMBERS = ("-o", "-s", "-t")
CLEAR = {"d": 1.0, "Tr": 0.0}  # values of an opaque material
CONSTANTS = {"Kd": "diffuseColor", "Ke": "emissiveColor", "Pr": "roughness", "Pm": "metallic"}


def read_libraries(
    obj: Path, libraries: Sequence[str], wanted: Sequence[str], notes: Notes
) -> tuple[dict[str, FileMaterial], list[Path]]:
    """The wanted materials by name, of the MTL files next to an OBJ file, and the files read.

    Notes are added for missing files and materials.  Raises InputError for an invalid line.
    """
    found: dict[str, FileMaterial] = {}
    read: list[Path] = []
    for text in dict.fromkeys(libraries):
        for path in _library_paths(obj, text):
            if not path.is_file():
                notes.add(f"its material file {path.name} is missing, so its colors are not read")
                continue
            read.append(path)
            for name, material in _Library(path, notes).materials().items():
                found.setdefault(name, material)
    absent = [name for name in wanted if name not in found]
    if absent and read:
        notes.add(
            f"material {', '.join(absent[:3])} is in none of its material files and has no color"
        )
    elif absent and not libraries:
        notes.add(
            f"it names materials ({', '.join(absent[:3])}) but no material file, so no "
            f"colors are read"
        )
    return {name: found[name] for name in wanted if name in found}, read


def _library_paths(obj: Path, text: str) -> list[Path]:
    """One name with spaces, where such a file exists; else one name per token."""
    whole = obj.parent / text.replace("\\", "/")
    if whole.is_file() or " " not in text:
        return [whole]
    return [obj.parent / token.replace("\\", "/") for token in text.split()]


class _Library:
    """The statements of one MTL file."""

    def __init__(self, path: Path, notes: Notes) -> None:
        self._path = path
        self._notes = notes
        self._done: dict[str, FileMaterial] = {}
        self._name: str | None = None
        self._values: dict[str, float | tuple[float, float, float]] = {}
        self._slots: list[Slot] = []

    def materials(self) -> dict[str, FileMaterial]:
        """All materials by name."""
        data = self._path.read_bytes()
        refuse_pointer(self._path, data)
        text = data.decode("utf-8-sig", errors="replace")
        for number, line in enumerate(text.replace("\r\n", "\n").split("\n"), start=1):
            tokens = line.split()
            if tokens:
                self._take(number, tokens)
        self._finish()
        return self._done

    def _finish(self) -> None:
        if self._name is not None:
            self._done[self._name] = FileMaterial(
                name=self._name, values=dict(self._values), texture_slots=tuple(self._slots)
            )
        self._values, self._slots = {}, []

    def _take(self, number: int, tokens: list[str]) -> None:
        key = tokens[0]
        if key == "newmtl":
            self._finish()
            self._name = " ".join(tokens[1:])
        elif self._name is None:
            return
        elif key in CONSTANTS:
            self._constant(number, tokens)
        elif key.lower() == "map_kd":
            self._texture(number, tokens[1:])
        elif key in CLEAR and _is_number(tokens[-1]) and float(tokens[-1]) != CLEAR[key]:
            self._notes.add(
                "transparency is not supported: the material is opaque", f"material {self._name}"
            )

    def _constant(self, number: int, tokens: list[str]) -> None:
        if tokens[1:2] in (["xyz"], ["spectral"]):
            self._notes.add(
                f"{tokens[0]} is given as {tokens[1]}, which is not read", f"material {self._name}"
            )
            return
        numbers = self._numbers(number, tokens[1:4])
        if not numbers:
            raise self._error(number, f"{tokens[0]} has no number")
        if tokens[0] in ("Pr", "Pm"):
            self._values[CONSTANTS[tokens[0]]] = numbers[0]
        else:
            r, g, b = (numbers * 3)[:3] if len(numbers) == 1 else (numbers + numbers[-1:])[:3]
            self._values[CONSTANTS[tokens[0]]] = (r, g, b)

    def _texture(self, number: int, tokens: list[str]) -> None:
        wrap, scale, offset = "repeat", [1.0, 1.0], [0.0, 0.0]
        i = 0
        while i < len(tokens) and tokens[i].startswith("-"):
            option = tokens[i]
            if option in NUMBERS:
                end = i + 1
                while end < min(i + 4, len(tokens)) and _is_number(tokens[end]):
                    end += 1
                numbers = self._numbers(number, tokens[i + 1 : end])
                target = {"-s": scale, "-o": offset}.get(option, [])
                target[: len(numbers)] = numbers[: len(target)]
            elif option in OPTIONS:
                end = i + 1 + OPTIONS[option]
                if option == "-clamp":
                    wrap = "clamp" if tokens[i + 1 : end] == ["on"] else "repeat"
            else:
                raise self._error(number, f"map_Kd has the unknown option {option}")
            i = end
        name = " ".join(tokens[i:])
        if not name:
            raise self._error(number, "map_Kd gives no file name")
        picture = self._picture(name)
        if picture is None:
            self._notes.add(
                f"its texture {name} does not exist: a constant color is used",
                f"material {self._name}",
            )
            return
        self._slots.append(
            Slot(
                input="diffuseColor",
                picture=picture,
                wraps=(wrap, wrap),
                uv_scale=(scale[0], scale[1]),
                uv_offset=(offset[0], offset[1]),
            )
        )

    def _picture(self, name: str) -> Picture | None:
        """The path as authored, or a file of that name next to the MTL file."""
        plain = name.replace("\\", "/")
        sibling = self._path.parent / plain.rsplit("/", 1)[-1]
        for path in (self._path.parent / plain, sibling):
            if path.is_file():
                if path == sibling and "/" in plain:
                    self._notes.add(f"its texture {name} was found next to the material file")
                return Picture(name=path.name, path=path)
        return None

    def _numbers(self, number: int, tokens: list[str]) -> list[float]:
        if not all(_is_number(token) for token in tokens):
            raise self._error(
                number, f"'{' '.join(tokens)}' contains a value that is not a finite number"
            )
        return [float(token) for token in tokens]

    def _error(self, line: int, what: str) -> InputError:
        return InputError(f"{self._path}, line {line}: {what}", REPAIR)


def _is_number(token: str) -> bool:
    try:
        return abs(float(token)) < float("inf")
    except ValueError:
        return False
