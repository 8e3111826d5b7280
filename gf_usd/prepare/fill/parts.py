"""Which meshes may be parts of one body, by what the stage states of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from gf_usd.core.asset import Asset
from gf_usd.core.errors import listed_paths
from gf_usd.core.stage import BodyPhysics, PhysicsMaterialSpec, StageSpec

PAINTED, SUBSETS, ANIMATED = (
    "has painted values",
    "has faces of several physics materials",
    "has an animation that ends at the start",
)
# what makes a mesh with each a possible part of another
REMEDIES = {
    PAINTED: "remove the painted values",
    SUBSETS: "bind one physics material to all faces",
    ANIMATED: "remove the animation before the start",
}


@dataclass(frozen=True)
class Parts:
    """Whether meshes may be joined where they enclose a volume only together.

    They may where the stage states the same physics of them: one body has one material and mass.
    """

    spec: StageSpec

    @cached_property
    def apart(self) -> Mapping[str, str]:
        """Why meshes are no part of another, by prim path: each has values of points or faces."""
        found = dict.fromkeys(self.spec.painted, PAINTED)
        for path, body in self._bodies.items():
            if body.subsets:
                found[path] = SUBSETS
            elif body.owner and body.moving is not None:
                found[path] = ANIMATED
        return found

    def alike(self, one: str, two: str) -> bool:
        """Whether meshes of two prim paths may be parts of one."""
        return not self._difference(one, two)

    def why_not(self, paths: Sequence[str]) -> str:
        """Why meshes cannot be parts of one, with prim paths; "" where they can."""
        for path in paths:
            if path in self.apart:
                return f"<{path}> {self.apart[path]}"
        found = (self._difference(paths[0], path) for path in paths[1:])
        return next((text for text in found if text), "")

    def remedy(self, paths: Sequence[str]) -> str:
        """What in the stage would make meshes that cannot be parts of one such parts."""

        own = {path: self.apart[path] for path in paths if path in self.apart}
        if not own:
            return "state the same physics of them"
        ways = (
            f"{REMEDIES[reason]} of {listed_paths([path for path in own if own[path] == reason])}"
            for reason in dict.fromkeys(own.values())
        )
        return " and ".join(ways)

    @cached_property
    def _bodies(self) -> Mapping[str, BodyPhysics]:
        return self.spec.bodies

    def _difference(self, one: str, two: str) -> str:
        """What the stage states differently of two meshes, "" if nothing."""
        a, b = (self._bodies.get(path, BodyPhysics(path=path)) for path in (one, two))
        bakes = self._bake_material(one), self._bake_material(two)
        advised = tuple(
            self.spec.advice[p].material if p in self.spec.advice else "" for p in (one, two)
        )
        if a.owner != b.owner:
            owners = (f"<{x.owner}>" if x.owner else "none" for x in (a, b))
            return _different(one, two, "physics body", *owners)
        if bakes[0] != bakes[1]:
            return _different(one, two, "gaussianFlesh:material", *(n or "none" for n in bakes))
        if _values(a.spec) != _values(b.spec):
            named = (f"<{x.spec.path}>" if x.spec.path else "none" for x in (a, b))
            return _different(one, two, "physics material", *named)
        if (a.mass, a.mass_of, a.density) != (b.mass, b.mass_of, b.density):
            return _different(one, two, "mass or density", _mass_text(a), _mass_text(b))
        if advised[0] != advised[1]:
            return _different(one, two, "material", *(n or "none" for n in advised))
        if a.owner and _others(a) != _others(b):
            return f"the stage states other physics of <{one}> than of <{two}>"
        return ""

    def _bake_material(self, path: str) -> str | None:
        bake = self.spec.bakes.get(path)
        return bake.material if bake else None


def _different(one: str, two: str, what: str, *values: str) -> str:
    return f"the {what} of <{one}> is {values[0]}, and that of <{two}> is {values[1]}"


def _mass_text(body: BodyPhysics) -> str:
    if body.mass is not None:
        return f"{body.mass:.6g} kg (of <{body.mass_of}>)"
    return "not stated" if body.density is None else f"{body.density:.6g} kg/m^3"


def _values(spec: PhysicsMaterialSpec) -> PhysicsMaterialSpec:
    """The values of a material, whatever its name is."""
    return replace(spec, path="")


def _others(body: BodyPhysics) -> BodyPhysics:
    """What is stated of a part of a physics body besides its material and its density."""
    return replace(
        body, path="", density_of="", spec=PhysicsMaterialSpec(), material=None, subsets=(),
        moving=None,
    )  # fmt: skip


def one_thing(asset: Asset, spec: StageSpec, one: str, two: str) -> bool:
    """Whether an inner and an outer mesh are of one physics body, component and material of the
    stage.
    """

    def of(path: str) -> tuple[str, str | None, str, PhysicsMaterialSpec]:
        body, bake, advice = spec.bodies.get(path), spec.bakes.get(path), spec.advice.get(path)
        return (
            body.owner if body else "",
            bake.material if bake else None,
            advice.material if advice else "",
            body.spec if body else PhysicsMaterialSpec(),
        )

    inner = spec.bodies.get(one)
    if one in spec.painted or (inner and inner.subsets):  # values that the outer mesh cannot have
        return False
    component = {s.path: s.component for s in asset.surfaces if s.path in (one, two)}
    return len(set(component.values())) == 1 and of(one) == of(two)


def collider_of(spec: StageSpec, one: str, two: str) -> str:
    """Of two meshes of a physics body the one that is a collider, where the other is none; or "".

    Robots have both: what is seen of a link, and a simpler shape that collides for it.
    """
    bodies = [spec.bodies.get(path, BodyPhysics(path=path)) for path in (one, two)]
    if not bodies[0].owner or bodies[0].owner != bodies[1].owner:
        return ""
    found = [body.path for body in bodies if body.collider]
    return found[0] if len(found) == 1 else ""


def of_their_own(spec: StageSpec) -> set[str]:
    """Paths of meshes with physics of their own, which one surface of several could not keep."""
    bodies = {
        body.path
        for body in spec.physics.bodies
        if body.owner or body.mass_of or body.material or body.subsets or body.density is not None
    }
    own = bodies | set(spec.painted) | {path for path, bake in spec.bakes.items() if bake.material}
    advised = {one.material for one in spec.advice.values()}
    return own | set(spec.advice) if len(advised) > 1 else own
