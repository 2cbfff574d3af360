"""Between versions of the standard: names up and down; joints that an older one lacks are folded."""

from __future__ import annotations

from dataclasses import replace

from vitruvian.errors import VitruvianError
from vitruvian.hanim import tables
from vitruvian.hanim.folding import fold, stand_in
from vitruvian.hanim.humanoid import Humanoid, Joint, MotionData, Segment, Site

VERSIONS = ("2.0", "200x", "1.1", "1.0")


def converted(humanoid: Humanoid, version: str, *, loa: int | None = None) -> tuple[Humanoid, list[str]]:
    """A copy of the humanoid under the names of `version`, at most at level `loa`, and what that can't say.

    `version` is one of "2.0", "200x", "1.1", "1.0". Upwards every name is looked up in the alias tables; unknown names
    are custom and stay. Downwards joints that exist in 2.0 only, and standard joints above `loa`, are folded into their
    nearest kept ancestor (toes into the second ray, which stands for all): geometry, sites and displacers move there,
    skin weights add up, their own animation is dropped (`vitruvian.motion.lowering` carries it). Arrays are shared with
    the original, which stays as it is.
    """
    if version not in VERSIONS:
        raise VitruvianError(f"H-Anim version: expected one of {', '.join(VERSIONS)}, found {version!r}")
    lost: list[str] = []
    keep: dict[str, str] = {}  # joint's own name -> its name there
    taken: set[str] = set()
    folded: dict[str, str] = {}
    roots: list[Joint] = []
    folds: list[tuple[Joint, Joint]] = []
    made: dict[str, Joint] = {}  # by 2.0 name
    stack: list[tuple[Joint, Joint | None]] = [(j, None) for j in reversed(humanoid.skeleton)]
    while stack:
        joint, parent = stack.pop()
        name = _there(joint.name, version, "joint")
        if loa is not None and _level(joint.name) > loa:
            name = None
        if name is None and parent is not None:
            folds.append((joint, parent))
            below = parent
        else:
            new = name or joint.name
            below = replace(
                joint,
                name=joint.name if new in taken else new,
                joints=[],
                segments=[_segment(s, version) for s in joint.segments],
                sites=[_site(s, version) for s in joint.sites],
                displacers=list(joint.displacers),
            )
            taken.add(below.name)
            keep[joint.name] = below.name
            made.setdefault(tables.canonical(joint.name) or joint.name, below)
            (roots if parent is None else parent.joints).append(below)
        stack.extend((j, below) for j in reversed(joint.joints))
    for joint, above in folds:
        other = stand_in(tables.canonical(joint.name) or "", made)
        into = above if other is None else made[other]
        fold(joint, into, lost)
        folded[joint.name] = into.name
    if folded:
        some = ", ".join(f"{a} into {b}" for a, b in list(folded.items())[:4]) + (", ..." if len(folded) > 4 else "")
        level = "" if loa is None else f" at LOA {loa}"
        lost.append(f"{len(folded)} joints that H-Anim {version} does not have{level} were folded ({some})")
    sites = {s.name: _site(s, version).name for s in [*humanoid.all_sites(), *humanoid.viewpoints]}
    rename = {**sites, **keep}
    names = [tables.canonical(n) or n for n in taken]
    out = replace(
        humanoid,
        version=version,
        loa=tables.complete_loa(names) if tables.family(version) == "2.0" else -1,
        skeleton=roots,
        sites=[_site(s, version) for s in humanoid.sites],
        viewpoints=[_site(s, version) for s in humanoid.viewpoints],
        motions=[_motion(m, keep) for m in humanoid.motions],
        tracks=[replace(t, target=rename.get(t.target, t.target)) for t in humanoid.tracks if t.target not in folded],
        binding={keep[k]: v for k, v in humanoid.binding.items() if k in keep},
    )
    dropped = sum(t.target in folded for t in humanoid.tracks) + sum(
        j in folded for m in humanoid.motions for j in m.joints
    )
    if dropped:
        lost.append(f"animation of {dropped} folded joints")
    return out, lost


def _there(name: str, version: str, kind: str) -> str | None:
    """The name in `version`; a custom name stays, a standard one that the version lacks is None."""
    return tables.name_in(name, version, kind) if tables.canonical(name, kind) else name


def _level(name: str) -> int:
    """Level of articulation that a joint belongs to; 0 for custom joints, which stay."""
    known = tables.canonical(name, "joint")
    return tables.joints()[known].loa if known else 0


def _segment(segment: Segment, version: str) -> Segment:
    return replace(
        segment,
        name=_there(segment.name, version, "segment") or segment.name,
        sites=[_site(s, version) for s in segment.sites],
        shapes=list(segment.shapes),
        displacers=list(segment.displacers),
    )


def _site(site: Site, version: str) -> Site:
    """Renamed; its suffix (`_pt`, `_tip`, `_view`) says what it is for and stays; 1.x wants one on feature points."""
    head, mark, tail = site.name.rpartition("_")
    suffix = f"_{tail}" if mark and tail in {"pt", "tip", "view"} else ""
    if suffix in {"_tip", "_view"}:
        return replace(site)
    plain = site.name[: -len(suffix)] if suffix else site.name
    known = tables.canonical(plain, "site")
    new = tables.name_in(plain, version, "site") if known else None
    if tables.family(version) == "1.x":
        suffix = suffix or "_pt"
    return replace(site, name=(new or plain) + suffix)


def _motion(motion: MotionData, keep: dict[str, str]) -> MotionData:
    """Joints renamed; what is gone becomes a placeholder that still takes its values."""
    known = {tables.canonical(k) or k: v for k, v in keep.items()}
    names = [keep.get(n) or known.get(tables.canonical(n) or n) or "IGNORED" for n in motion.joints]
    return replace(motion, joints=names)
