"""The stages of a substep, in order, and their parts.

The parts of a stage do not wait for each other, and neither do the items of a part: they write to
what is their own.  `kernels` says what a part does with an item.
"""

from __future__ import annotations

from dataclasses import dataclass

# Of what a part has an item each.
FREE, FOLLOWERS, NODES, GROUPS, SAMPLES = "free", "followers", "nodes", "groups", "samples"
REGIONS = "regions"  # rigid ones
PAIRED = "paired"  # samples of contact pairs, with a body or an obstacle

# When a stage is due: in every substep, where a frame opens, where the filter acts, where samples
# meet.
ALWAYS, OPENING, FILTERING, TOUCHING = "always", "opening", "filtering", "touching"

APART = 32  # numbers between the two counters of a launch: they share no cache line
STUCK = 2 * APART  # where threads of a GPU note that others never came
QUEUE = 3 * APART  # numbers of the array that they stand in
# Threads of a block on a GPU.  With 256 a thread has 128 registers, and a body with viscosity takes
# 1.28 times as long (H200, a million particles).
BLOCK = 128

OPENS, CLOSES = 1, 2  # bits: a launch begins a frame, ends one

# Items that are worth a piece of their own: a group is eight cells, some 64 particles.
GRAIN = 256
GROUP_GRAIN = 4


# Parts that do the same: over ways of their own, or with the filter's momenta instead of forces.
SAME = {
    "open followers": "follow", "filtered followers": "follow", "loss": "share",
    "filter lumped": "move lumped", "filter": "move",
}  # fmt: skip


@dataclass(frozen=True)
class Part:
    """One thing that is done to each item."""

    name: str
    items: str

    @property
    def work(self) -> str:
        """What is done."""
        return SAME.get(self.name, self.name)


@dataclass(frozen=True)
class Stage:
    """Parts that may be done at once."""

    parts: tuple[Part, ...]
    when: str = ALWAYS


def works(table: tuple[Stage, ...]) -> tuple[tuple[Part, tuple[int, ...]], ...]:
    """What is done in a table of stages, each once: a part that does it, and the numbers of the
    stages that it is in.

    Code that stands at several places is read, optimized and translated several times.
    """
    found: dict[str, tuple[Part, tuple[int, ...]]] = {}
    for number, stage in enumerate(table):
        for part in stage.parts:
            first, numbers = found.get(part.work, (part, ()))
            found[part.work] = first, (*numbers, number)
    return tuple(found.values())


def stages(plain: bool, meets: bool, coupled: bool, rigid: bool = False) -> tuple[Stage, ...]:
    """The stages of a substep; `groups` are particles where plain.

    meets : bodies meet each other or obstacles; coupled : nodes share their mass with neighbors;
    rigid : regions move as rigid bodies.
    """

    def stage(*parts: tuple[str, str], when: str = ALWAYS) -> Stage:
        return Stage(tuple(Part(*part) for part in parts), when)

    summed = [stage(("node force", NODES))] if plain else []
    gathered = [stage(("node momentum", NODES), when=FILTERING)] if plain else []
    motion = [("sample motion", PAIRED)] if meets else []
    pairs = [("pair contact", PAIRED)] if meets else []
    totals = [stage(("pair total", PAIRED), when=TOUCHING)] if meets else []
    lost = [stage(("filter lumped", FREE), when=FILTERING)] if coupled else []
    pushed = [stage(("move lumped", FREE))] if coupled else []

    def regions(name: str) -> list[tuple[str, str]]:
        return [(f"{name} rigid", REGIONS)] if rigid else []

    return (
        stage(("open", FREE), *regions("open"), when=OPENING),
        stage(("open followers", FOLLOWERS), when=OPENING),
        stage(("momentum", GROUPS), when=FILTERING),
        *gathered,
        stage(("loss", FOLLOWERS), when=FILTERING),
        *lost,
        stage(("filter", FREE), *regions("filter"), when=FILTERING),
        stage(("filtered followers", FOLLOWERS), when=FILTERING),
        stage(("stress", GROUPS), *motion, ("contact", SAMPLES)),
        *summed,
        stage(("share", FOLLOWERS), *pairs),
        *totals,
        *pushed,
        stage(("move", FREE), *regions("move")),
        stage(("follow", FOLLOWERS)),
    )
