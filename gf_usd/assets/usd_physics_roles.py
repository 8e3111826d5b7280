"""What UsdPhysics does with a prim: nothing, hold it, follow its animation, or let it fall."""

from __future__ import annotations

from pxr import Usd

RIGID_BODY = "PhysicsRigidBodyAPI"
# The AOUSD proposal's and Omniverse's, with the attributes that switch each on and make it follow
# its animation: usd-core defines neither schema.
SOFT_BODIES = {
    "PhysicsDeformableBodyAPI": ("physics:bodyEnabled", "physics:kinematicEnabled"),
    "OmniPhysicsDeformableBodyAPI": (
        "omniphysics:deformableBodyEnabled",
        "omniphysics:kinematicEnabled",
    ),
}
BODIES = {RIGID_BODY: ("physics:rigidBodyEnabled", "physics:kinematicEnabled"), **SOFT_BODIES}
COLLISION = "PhysicsCollisionAPI"


def apis(prim: Usd.Prim) -> set[str]:
    """Names of the applied API schemas, also of those that this USD has no definition of."""
    return {*prim.GetAppliedSchemas(), *prim.GetPrimTypeInfo().GetAppliedAPISchemas()}


def switch(prim: Usd.Prim, name: str, time: Usd.TimeCode, *, otherwise: bool) -> bool:
    """A boolean attribute's value."""
    attribute = prim.GetAttribute(name)
    value = attribute.Get(time) if attribute else None
    return otherwise if value is None else bool(value)


def body_of(prim: Usd.Prim, time: Usd.TimeCode) -> Usd.Prim | None:
    """The prim, or the nearest above it, that is an enabled rigid or deformable body."""
    above = prim
    while above and not above.IsPseudoRoot():
        for api in apis(above) & BODIES.keys():
            if switch(above, BODIES[api][0], time, otherwise=True):
                return above
        above = above.GetParent()
    return None


def is_collider(prim: Usd.Prim, time: Usd.TimeCode) -> bool:
    """Whether the prim itself is an enabled collider."""
    return COLLISION in apis(prim) and switch(
        prim, "physics:collisionEnabled", time, otherwise=True
    )


def role(prim: Usd.Prim, time: Usd.TimeCode) -> str:
    """dynamic: part of a body that forces move; kinematic: of one that follows its animation;
    static: a collider without a body; "": none of them.
    """
    body = body_of(prim, time)
    if body is None:
        return "static" if is_collider(prim, time) else ""
    follows = any(
        switch(body, BODIES[api][1], time, otherwise=False) for api in apis(body) & BODIES.keys()
    )
    return "kinematic" if follows else "dynamic"
