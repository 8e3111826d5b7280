"""What is written of a body in motion: poses of meshes and Gaussians, sample by sample."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from gf_usd.carrying import Carrier
from gf_usd.checkpoint import Checkpoint
from gf_usd.model import BakedFrame, Frame, GaussianPose, Material, MeshPose, Pose
from gf_usd.plan import Plan
from gf_usd.timeline import sampled


class Moving:
    """One look of a plan.

    carrier : of its captured Gaussians.
    since : where to go on from; None: at its start.
    """

    def __init__(
        self, plan: Plan, material: Material, carrier: Carrier, since: Checkpoint | None = None
    ) -> None:
        from gf_usd.geometry.skinning import MeshSkin
        from gf_usd.physics.gaussians import GaussianTrack

        self._plan, self._carrier, self._since = plan, carrier, since
        self.track = GaussianTrack(plan.particles.orientation, plan.particles.scale)
        self._skin = None
        if plan.points and plan.settings.skin != "embed":
            self._skin = MeshSkin(plan.settings.skin, plan.points, plan.particles.X)
        self.solver = plan.solver(material)
        if since:
            self.solver.stand(since.solver)
            self.track.recall(since.track)

    def samples(self) -> Iterator[BakedFrame]:
        """The samples, in playback time.  Raises SolverError where the simulation fails."""
        since = self._since
        frames = (
            self.solver.frames_after(since.index, since.last) if since else self.solver.frames()
        )
        for frame in frames:
            gaussians = self.track.advance(frame.particles)
            poses = frame.riders
            if self._skin:
                poses = self._skin.poses(frame.particles, self.track.turn)
            yield self._baked(frame, gaussians, poses)

    def _baked(
        self, frame: Frame, gaussians: GaussianPose, poses: Mapping[str, Pose]
    ) -> BakedFrame:
        from gf_usd.physics.embedding import deform_normals

        plan, s = self._plan, sampled(self._plan.settings)
        meshes = {}
        splats = self._carrier.poses(poses, s.time_code(frame.index))
        for surface in plan.asset.surfaces if plan.choices.mesh else ():
            if surface.splats is not None:
                continue
            pose = poses[surface.path]
            normals = None
            if surface.normals is not None and surface.normal_points is not None:
                normals = deform_normals(surface.normals, surface.normal_points, pose.F)
            meshes[surface.path] = MeshPose(
                points=pose.x, velocities=pose.v * s.time_scale, normals=normals
            )
        return BakedFrame(
            index=frame.index,
            time_code=s.time_code(frame.index),
            meshes=meshes,
            gaussians=replace(
                gaussians,
                velocities=gaussians.velocities * s.time_scale,
                F=frame.particles.F if s.deformation_gradients else None,
                stress=frame.stress,
            ),
            health=frame.health,
            splats=splats if plan.choices.mesh else {},
        )
