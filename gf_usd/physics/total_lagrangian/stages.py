"""The stages of a substep in their order of execution, and the parts of each stage.

The parts of a stage are independent of each other, and so are the items of a part: each item writes
only to its own entries of the arrays. `kernels.substep` implements what a part does to an item.
"""

from __future__ import annotations

from dataclasses import dataclass

# The entity of which a part processes one item each.
FREE, DEPENDENT, NODES, GROUPS, SAMPLES = "free", "dependent", "nodes", "groups", "samples"
REGIONS = "regions"  # rigid ones
PAIRED = "paired"  # samples of contact pairs, with a body or an obstacle

# When a stage runs: in every substep, in the first substep of a frame, in substeps with the APIC
# filter, or in substeps in which contact samples have a contact pair.
ALWAYS, OPENING, FILTERING, TOUCHING = "always", "opening", "filtering", "touching"

APART = 32  # numbers between the counters of a launch, so that they share no cache line
STUCK = 2 * APART  # index of the flag that a grid barrier of the GPU timed out
QUEUE = 3 * APART  # length of the array that holds the counters and the flag
# Threads per block on a GPU. With 256, a thread is limited to 128 registers, and a body with
# viscosity takes 1.28 times as long (H200, a million particles).
BLOCK = 128

OPENS, CLOSES = 1, 2  # bits: a launch is the first of a frame, is the last of one

# Least number of items in one piece of work: a group is eight cells, some 64 particles.
GRAIN = 256
GROUP_GRAIN = 4


# Parts that share one implementation: with another drift time, or with the filter's momenta instead
# of forces.
SAME = {
    "filtered dependent nodes": "follow", "loss": "share",
    "filter lumped": "move lumped", "filter": "move",
}  # fmt: skip


@dataclass(frozen=True)
class Part:
    """One operation, applied to each item of a kind."""

    name: str
    items: str

    @property
    def work(self) -> str:
        """Name of the implementation."""
        return SAME.get(self.name, self.name)


@dataclass(frozen=True)
class Stage:
    """Parts that may run at the same time."""

    parts: tuple[Part, ...]
    when: str = ALWAYS


def distinct_works(table: tuple[Stage, ...]) -> tuple[tuple[Part, tuple[int, ...]], ...]:
    """The distinct implementations in a table of stages: for each, a part that uses it, and the
    indices of the stages that contain it.

    The kernels contain each implementation once: code that is inlined at several places is parsed,
    optimized and translated several times.
    """
    found: dict[str, tuple[Part, tuple[int, ...]]] = {}
    for number, stage in enumerate(table):
        for part in stage.parts:
            first, numbers = found.get(part.work, (part, ()))
            found[part.work] = first, (*numbers, number)
    return tuple(found.values())


def stages(
    plain: bool, pair_contact: bool, coupled: bool, rigid: bool = False
) -> tuple[Stage, ...]:
    """The stages of a substep.

    plain : one thread per particle; the items of `groups` are then particles.
    pair_contact : bodies are in contact with each other or with obstacles.
    coupled : the mass matrix couples neighboring nodes.
    rigid : some regions move as rigid bodies.
    """

    def stage(*parts: tuple[str, str], when: str = ALWAYS) -> Stage:
        return Stage(tuple(Part(*part) for part in parts), when)

    summed = [stage(("node force", NODES))] if plain else []
    gathered = [stage(("node momentum", NODES), when=FILTERING)] if plain else []
    motion = [("sample motion", PAIRED)] if pair_contact else []
    pairs = [("pair contact", PAIRED)] if pair_contact else []
    totals = [stage(("pair total", PAIRED), when=TOUCHING)] if pair_contact else []
    lost = [stage(("filter lumped", FREE), when=FILTERING)] if coupled else []
    pushed = [stage(("move lumped", FREE))] if coupled else []

    def regions(name: str) -> list[tuple[str, str]]:
        return [(f"{name} rigid", REGIONS)] if rigid else []

    return (
        stage(("open", FREE), *regions("open"), when=OPENING),
        stage(("open dependent nodes", DEPENDENT), when=OPENING),
        stage(("momentum", GROUPS), when=FILTERING),
        *gathered,
        stage(("loss", DEPENDENT), when=FILTERING),
        *lost,
        stage(("filter", FREE), *regions("filter"), when=FILTERING),
        stage(("filtered dependent nodes", DEPENDENT), when=FILTERING),
        stage(("stress", GROUPS), *motion, ("contact", SAMPLES)),
        *summed,
        stage(("share", DEPENDENT), *pairs),
        *totals,
        *pushed,
        stage(("move", FREE), *regions("move")),
        stage(("follow", DEPENDENT)),
    )
