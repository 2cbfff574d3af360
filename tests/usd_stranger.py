"""What OpenUSD itself makes of our files: skinned points and findings, without our reader."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel


def skinned(path: Path, code: float) -> dict[str, np.ndarray]:
    """Points of every skinned mesh (name -> (n,3)) in the space of its skeleton, as UsdSkel computes them."""
    stage, cache, out = Usd.Stage.Open(str(path)), UsdSkel.Cache(), {}
    for prim in stage.Traverse():
        if not prim.IsA(UsdSkel.Root):
            continue
        root = UsdSkel.Root(prim)
        cache.Populate(root, Usd.PrimDefaultPredicate)
        for binding in cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate):
            query = cache.GetSkelQuery(binding.GetSkeleton())
            matrices = query.ComputeSkinningTransforms(code)
            for target in binding.GetSkinningTargets():
                points = UsdGeom.Mesh(target.GetPrim()).GetPointsAttr().Get()
                if target.HasBlendShapes() and query.GetAnimQuery():
                    _morph(target, query.GetAnimQuery(), code, points)
                name = target.GetPrim().GetName()
                if target.IsRigidlyDeformed():
                    m = np.array(target.ComputeSkinnedTransform(matrices, code))
                    out[name] = np.array(points, float) @ m[:3, :3] + m[3, :3]
                else:
                    assert target.ComputeSkinnedPoints(matrices, points, code)
                    out[name] = np.array(points, float)
    return out


def _morph(target, animation, code, points) -> None:
    weights = target.GetBlendShapeMapper().Remap(animation.ComputeBlendShapeWeights(code))
    if not weights:
        return
    shapes = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(target.GetPrim()))
    sub, index, offset = shapes.ComputeSubShapeWeights(weights)
    where, moves = shapes.ComputeBlendShapePointIndices(), shapes.ComputeSubShapePointOffsets()
    assert shapes.ComputeDeformedPoints(sub, index, offset, where, moves, points)


def findings(path: Path) -> list[str]:
    """What USD's own validators say: those of usdchecker."""
    try:
        from pxr import UsdValidation
    except ImportError:  # before 25.02
        from pxr import UsdUtils

        checker = UsdUtils.ComplianceChecker(arkit=False)
        checker.CheckCompliance(str(path))
        return [*checker.GetErrors(), *checker.GetFailedChecks(), *checker.GetWarnings()]
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 20
    found = UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(path)))
    return [f"{e.GetName()}: {e.GetMessage()}" for e in found]
