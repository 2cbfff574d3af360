"""The doctor's rules as data: what each finds, why it matters in real browsers, what to do, what `--fix` does.

Findings take their severity from here, `vitruvian check --rules` prints it, docs/rules.md is made of it.
Severity E is broken (error), W likely wrong (warning), N worth knowing (note). `auto` says what `--fix` repairs: "yes"
always when only one answer fits, "opt" when asked for by `--also RULE`, "part" the part that has one answer, "no" none.
"""

# ruff: noqa: E501  (one rule, one line)
from __future__ import annotations

from dataclasses import dataclass

SEVERITIES = {"E": "error", "W": "warning", "N": "note"}
GROUPS = {
    "F": "The file",
    "V": "Versions and levels of articulation",
    "N": "Names",
    "T": "The tree of joints",
    "P": "Places: rest pose, centres, size",
    "S": "Skin",
    "D": "Displacers, masses, limits, sites",
    "M": "Why it does not move",
}
_FIXES = {"yes": "always", "opt": "on request", "part": "partly", "no": "no"}


@dataclass(frozen=True, slots=True)
class Rule:
    """`severity` E, W or N; `auto` yes, opt, part or no. `why` is one sentence without its full stop."""

    id: str
    severity: str
    finds: str
    why: str
    repair: str
    auto: str


_TABLE = """
F01 E yes | header missing, wrong or that of another encoding | a loader chooses its parser by the header and refuses the file | write the right header
F02 E no | a syntax error | nothing at all is shown | mend the line that is named; what stands before it was read
F03 W no | a node or field that nobody knows | browsers skip it in silence, so that a misspelt field has its default value | take the nearest legal name
F04 E yes | a DEF given twice, or one with a blank or another sign that XML does not allow there | USEs and ROUTEs hit the wrong node | rename the later one; its USEs and ROUTEs follow
F05 E no | a USE without a DEF before it, or one that holds itself | the node is dropped, or the walk never ends | move the DEF before its USE; cut the cycle
F06 W yes | a wrong or missing containerField under Humanoid, Joint or Segment | the node lands in another field and is neither skeleton nor skin nor displacer | give the containerField that its type and place want
F07 W yes | profile and components that do not cover the nodes | strict browsers refuse the file | add the component
F08 N no | urls of inlines, textures, scripts or prototypes that are not at hand | those parts are missing in the browser | put the files beside the scene
F09 W no | what the X3D XML schema refuses, known defects of the schema left out (only with --schema) | strict tools refuse the file | as the schema's message says
V01 W yes | a version that this kind of file does not have | the default differs from browser to browser | 2.0, 1.0 or 200x, as the names of the joints say
V02 W yes | a level of articulation whose joints are not all there | motion made for that level meets gaps | claim the largest level that is complete
V03 N yes | joints beyond the claimed level | legal, but tools that trust the claim overlook them | raise the claim when a higher level is complete
V04 W yes | 1.x names in a 2.0 humanoid | motion and tools that go by names miss the joint | rename by the standard's table of aliases
V05 N yes | HumanoidRoot or humanoid_root where the other is expected | X_ITE's motions find humanoid_root alone | rename the root
N01 E yes | a joint, segment or site without a name | nothing can address it | take the name from its DEF when that is a standard one
N02 E yes | a name that is not standard though close to one | motion does not find it | take the standard name when only one is close
N03 N no | a joint name that is not in the tables | allowed for additions such as tails; motion made for others leaves it still | nothing, if it is meant
N04 E no | one name for two joints of a humanoid | motion drives one of them | rename one
N05 N opt | DEFs that do not start with the humanoid's prefix | two humanoids in one scene get mixed up | prefix hanim_, or the humanoid's name when there are several
N06 N opt | sites, displacers or coordinates without the suffix that says what they are | tools tell end effectors, cameras and feature points by it | add _tip, _view, _pt, _feature, _action, _coords
N07 W yes | a segment on a joint that it does not belong to | tools pair joints and segments by the standard's table | give the segment the name that belongs to the joint
N08 W yes | a humanoid without a name, or two with the same | their DEF prefixes collide | take the name from the DEF; number the later ones
T01 E no | an empty skeleton, or one that does not start at humanoid_root | there is nothing to animate from | make humanoid_root the root of the skeleton
T02 E no | a joint that hangs under one that is not above it in the standard | motion turns the wrong parts along | hang it under its standard parent, the centre stays
T03 N no | a variant of the tree that the schema's text has | occurs in good files; the standard's own tree differs | nothing
T04 E yes | a joint that the tree reaches twice | it is drawn and moved twice | take the second place out
T05 W no | a standard joint missing between two that are there | motion of the missing joint is lost | add the joint
P01 W yes | joints that are turned, moved or scaled in the file | motion assumes that rest is zero | bake the pose into centres, skin and segments
P02 W no | a joint other than the root without a center | it turns about the floor | give its centre
P03 W opt | centres of left and right that are no mirror images | motion is lopsided | mirror the left side
P04 W no | a figure that does not stand in the default pose | retargeted motion is off by the difference | pose it anew: arms down, palms in, feet forward
P05 W opt | a figure off the ground or the axis, or of a size that no human has | it floats, or is a giant among others | give the Humanoid a scale and a translation
P06 E part | numbers that are not finite, are too few or no numbers; zero or negative scale; axes that are not of length 1 | parts vanish, turn inside out or fly off | axes are made unit; with --also P06 what is no number is zero or default; a scale is yours to choose
P07 W no | a joint far outside the mesh | limbs turn about a point in the air | move mesh or joint
S01 E opt | more or fewer weights than indices | browsers differ: the last weight counts on, or memory beyond the end | the last weight for the missing ones; those beyond are cut
S02 E yes | skin indices outside the points | a crash, or triangles through the room | drop the pair
S03 W yes | weights of a point that do not sum to 1 | below 1 it sticks to rest, above 1 it overshoots | divide by the sum
S04 W opt | points without any weight | they stay behind when the body moves | the weights of the nearest weighted point on the mesh
S05 E part | weights that are all zero, negative or above 1 | the skin does not follow, or explodes | clamp; what is all zero needs a weight transfer
S06 W yes | a point named twice by one joint | its weight acts twice | one entry with the sum
S07 N no | more than four influences on a point | glTF and VRM keep four | nothing in X3D
S08 E yes | normals that do not fit the points | wrong shading; one browser crashes | compute them anew from the faces
S09 E opt | faces that index beyond the points, or with fewer than three corners | faces are missing | drop those faces
D01 E yes | a displacer that indexes beyond the mesh, or with other counts than displacements | a crash, or the displacer is ignored | cut to what fits
D02 W opt | a joint's displacer where there is no skinCoord; with --schema any displacer of a joint | it has no effect; schemas of 4.0 refuse it though the standard allows it | move it to the segment when its indices fit there
D03 N no | a displacer of weight 0 that no ROUTE drives | it never shows | drive its weight
D04 W opt | masses, inertias and centres of mass that no body can have | physics tools fail | symmetrise, or compute them anew from the mesh
D05 W yes | limits that are crossed or of a wrong count, stiffness outside 0..1 | inverse kinematics refuses the joint | swap, pad with free axes, clamp
D06 W no | a site that hangs nowhere | it follows nothing | put it under its segment
M01 E yes | a list of joints that is empty or lacks joints of the skeleton | X_ITE keeps their skin at rest | list every joint of the skeleton
M02 E yes | a joint listed twice | its weights act twice | list it once
M03 E yes | copies of joints in the list instead of USEs | the copy turns, the skeleton does not | USE the joint of the skeleton
M04 E yes | a skinCoord that is not the Coordinate of the skin's faces | the mesh never deforms | one Coordinate in both places when the points are equal
M05 E opt | weights where there is no skin | nothing of it is drawn | put the Shape that has those points into skin
M06 E no | a skin without weights | it stays where it is | transfer weights from another body
M07 E opt | a ROUTE with a missing end, an unknown field, the wrong direction or different types | no event arrives | the nearest name; turn the ROUTE round
M08 E no | an interpolator that nothing drives, or a timer that drives nothing | no event comes out | ROUTE fraction_changed to set_fraction
M09 W opt | a clock that never runs | the figure looks frozen | loop and enabled TRUE, a positive cycleInterval, no stopTime
M10 E opt | keys and values that do not fit, keys that go backwards or leave 0..1 | the output is undefined | cut, sort, scale to 0..1
M11 N no | interpolators that give the same value all the time | there is nothing to see | nothing, or give them motion
M12 W no | a clock that waits for a touch or for somebody near | it looks frozen until the user acts | touch it, or start it by itself
M13 E no | two sources for one field | the last writer wins, it flickers | keep one
M14 W opt | an HAnimMotion that is not enabled, or does not say whether it loops | engines differ on the default, FALSE stands still | write enabled and loop TRUE
M15 E part | an HAnimMotion outside motions, or with counts that do not fit | it has no frames, or they shift | put it into motions; counts are yours to mend
M16 E yes | an HAnimMotion that names a joint by another name than the skeleton | that joint stands still | the skeleton's name in the list
M17 W opt | an HAnimMotion without time or frames to play | it stands still | the defaults
M18 W opt | positions far from rest, or degrees where radians are meant | the figure flies off, or spins | start at rest; turn degrees into radians
M19 W no | something above the humanoid that hides it | nothing is seen | show it
M20 N no | a skin in a PROTO humanoid | plain VRML browsers do not deform it, X_ITE takes it for a Transform | write it as X3D
M21 W opt | shapes of a humanoid outside any Segment or skin | they do not follow the joints everywhere | put them into the segment of the nearest joint
M22 N no | fields that a Script drives | the script is not run here | nothing
"""


def _rules() -> dict[str, Rule]:
    rules = {}
    for line in _TABLE.strip().splitlines():
        head, finds, why, repair = (part.strip() for part in line.split(" | "))
        name, severity, auto = head.split()
        rules[name] = Rule(name, severity, finds, why, repair, auto)
    return rules


RULES: dict[str, Rule] = _rules()


def rules_text() -> str:
    """All rules for a terminal: a line of what each finds, then why it matters and what to do."""
    lines = []
    for letter, title in GROUPS.items():
        lines.append(title)
        for rule in RULES.values():
            if rule.id.startswith(letter):
                lines.append(f"  {rule.id} {SEVERITIES[rule.severity]:7} {rule.finds}")
                lines.append(f"{'':14}why: {rule.why}")
                lines.append(f"{'':14}do:  {rule.repair} [--fix: {_FIXES[rule.auto]}]")
    return "\n".join(lines)


def rules_page() -> str:
    """All rules as a page of the documentation (Markdown)."""
    lines = [
        "# What the doctor looks for",
        "",
        f"`vitruvian check FILE` knows {len(RULES)} rules about H-Anim files. Errors (E) break something in a browser and",
        "make the command end with status 1; warnings (W) are likely wrong; notes (N) are worth knowing. `--why` prints",
        "the reason beside each finding, `--rules` this table.",
        "",
        "`--fix OUT` writes a repaired file and says what it changed: *always* stands for what has one right answer, *on",
        "request* for what `--also RULE` (or `--also all`) asks for, *partly* for the part that has one right answer.",
        "Repairing twice changes nothing more than repairing once, and what no rule is about stays as it was.",
        "",
        "This page is made from `vitruvian/hanim/doctor_rules.py` by `tools/write_rules_page.py`.",
    ]
    for letter, title in GROUPS.items():
        lines += ["", f"## {title}", "", "| rule | | finds | why it matters | what to do | `--fix` |"]
        lines.append("| --- | --- | --- | --- | --- | --- |")
        for r in RULES.values():
            if r.id.startswith(letter):
                lines.append(f"| {r.id} | {r.severity} | {r.finds} | {r.why} | {r.repair} | {_FIXES[r.auto]} |")
    return "\n".join(lines) + "\n"
