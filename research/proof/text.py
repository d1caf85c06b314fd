"""A proof and its certificate for a terminal: sentences that judge, tables with the numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from mmnn_pin.lab.psi.learner import NAMES
from mmnn_pin.lab.psi.rate import Rate
from mmnn_pin.lab.show.psi import learned_parts, notes, small, words
from mmnn_pin.lab.show.table import WIDTH, Cell, Column, Row, Table, TextLine, number, row_of, terminal_text
from mmnn_pin.sensing.settings import LARGEST_NOISE
from mmnn_pin.shown import shows

from .balance import TOLERANCE, Balance
from .certificate import Certificate
from .certified_loop import Condition
from .certified_run import CertifiedRun, Comparison
from .linear import LinearFit
from .lyapunov import TERMS, Growth, Lyapunov
from .proof import IdealWeights, Proof
from .truth import Truth
from .tube import Tube

PARTS = {"pose": "V1 of the pose", "motion": "s' M s / 2", "weights": "weights' part"}
PRINTED = "The thesis's bounds, as printed: not proved"
RIGHT = 1e-6  # share of Psi up to which it counts as known
ENDLESS = 1e12  # weights of this size say only that hardly anything multiplies them


@shows(Proof, "text")
def render(proof: Proof, colour: bool = False, width: int = WIDTH) -> str:
    """The whole proof as text of at most `width` columns."""
    return terminal_text(parts(proof), colour, width)


@shows(CertifiedRun, "text")
def render_certificate(run: CertifiedRun, colour: bool = False, width: int = WIDTH) -> str:
    """The section on the certificate as text of at most `width` columns."""
    return terminal_text(certificate_parts(run), colour, width)


# -- the proof --


def parts(proof: Proof) -> Iterator[str | TextLine | Table]:
    """Title, sentences, tables and notes, in order."""
    subject = proof.subject
    yield from learned_parts(proof, ideal_rows(proof.ideal) if proof.has("ideal") else ())
    if proof.has("load") and proof.load is not None:
        yield f"{str(proof.load)[0].upper()}{str(proof.load)[1:]}."
    if proof.has("lyapunov"):
        yield lyapunov_sentence(proof.lyapunov, proof.growth)
        yield terms_table(proof.growth)
        if spans := spans_sentence(proof.growth):
            yield spans
    if proof.has("balance"):
        yield balance_sentence(proof.balance, f"{subject.timing.integrator} at {subject.timing.plant_step:g} s")
    yield from notes(proof)


def ideal_rows(ideal: IdealWeights) -> Iterator[Row]:
    """The best weights that there are, and how far the run's weights are from them."""
    if isinstance(ideal, Truth):
        for part, ends in ideal.parts.items():
            yield row_of(f"distance in V from the true parameters, {part}, start to end", start_to_end(*ends))
        yield row_of("largest |Psi - Y theta| of the true ones [N, N m]", number(ideal.eps.max()))
    elif isinstance(ideal, LinearFit):
        best = "the true parameters" if ideal.true else "the best fixed weights, fitted offline"
        yield row_of(f"|W*| of {best}", size(ideal.norm))
        if ideal.still:
            yield row_of("weights that this run does not determine: their features stay 0", str(ideal.still))
        away = "its Psi_hat against the run's, over Psi's deviation, start to end"
        yield row_of(away, start_to_end(*ideal.distance))
        yield row_of("eps_N: what W* leaves at most [N, N m]", number(ideal.eps.max()))
        yield row_of("FVU of W* (worst component)", number(ideal.unexplained.max()))
    else:
        columns = {
            "|Z| learned": [number(w.learned_norm) for w in ideal.values()],
            "|Z*| of the ideal weights, fitted offline": [size(w.norm) for w in ideal.values()],
            "ZB that the robust term counts with": [number(w.assumed) for w in ideal.values()],
            "|Z* - Z| from start to end": [start_to_end(w.start_distance, w.distance) for w in ideal.values()],
            "eps_N: what the ideal weights leave at most": [number(w.eps_N) for w in ideal.values()],
            "FVU of the ideal weights (worst component)": [number(w.unexplained.max()) for w in ideal.values()],
        }
        yield from (row_of(label, *cells) for label, cells in columns.items())


def size(norm: float) -> str:
    """The size of some weights, or that they have none that means anything."""
    return "not determined: features hardly move" if norm > ENDLESS else number(norm)


def start_to_end(start: float, end: float) -> str:
    """Two numbers of a run."""
    return f"{number(start)} to {number(end)}"


def lyapunov_sentence(v: Lyapunov, growth: Growth) -> str:
    """V from start to end, and how much of the time it grows."""
    kept = [(words, getattr(v, name)) for name, words in PARTS.items() if getattr(v, name).any()]
    shown = ", ".join(f"{words} {number(part[0])} to {number(part[-1])}" for words, part in kept)
    text = f"Lyapunov function V: {number(v.total[0])} to {number(v.total[-1])} ({shown}). "
    if not growth.samples:
        return f"{text}It falls all the time."
    what = (
        "control periods" if v.every == 1 else f"intervals of {v.period:g} s from one update of the weights to the next"
    )
    return (
        f"{text}It grows in {100 * growth.samples:.0f} % of the {what}, by {number(growth.rise)} in all, and falls by "
        f"{number(growth.fall)}."
    )


def terms_table(growth: Growth) -> Table:
    """What every term adds to V over the run, and how often it is the one that makes it grow."""
    largest = max(map(abs, growth.work.values()))
    rows = (
        row_of(name, text, signed(growth.work[name]), f"{100 * growth.why[name]:.0f} %" if name in growth.why else "")
        for name, text in TERMS.items()
        if abs(growth.work[name]) > 1e-9 * largest
    )
    columns = words("term"), words(""), Column("adds to V"), Column("leads its growth")
    return Table("What the terms add to V", columns, tuple(rows))


def spans_sentence(growth: Growth) -> str:
    """The stretches of most growth."""
    spans = [f"{s.start:.3g} to {s.end:.3g} s (+{number(s.rise)}, {s.why})" for s in growth.spans]
    return f"Most growth: {'; '.join(spans)}.\n" if spans else ""


def balance_sentence(balance: Balance, integrator: str) -> str:
    """Whether the equality holds, with its worst errors."""
    steps = small(balance.steps) if math.isfinite(balance.steps) else "not known"
    plant = f"that integrator's error, {small(balance.recorded)} between the recorded states, is not in it"
    off = f" The run was simulated by {integrator}: {plant}." if balance.recorded > TOLERANCE else ""
    return (
        f"Equality d/dt (s' M s / 2) = s' (Psi - tau + d): {'holds' if balance.holds else 'IS VIOLATED'}, checked "
        f"along exact motions from the recorded states. Worst relative errors over {len(balance.time):,} of "
        f"{balance.periods:,} control periods: model and command {small(balance.identity)}, recorded states against "
        f"the plant's own steps {steps} (tolerance {TOLERANCE:g}).{off}"
    )


def signed(value: float) -> str:
    """A number with its sign."""
    return f"{'-' if value < 0 else '+'}{number(abs(value))}"


# -- the certificate --


def certificate_parts(run: CertifiedRun) -> Iterator[str | TextLine | Table]:
    """Title, sentences and tables, in order."""
    yield ""
    yield TextLine("Certificate (mmnn docs explanation/theory)", "bold")
    if run.certificate is None:
        yield f"Does not apply: {run.missing['certificate'].removeprefix('no certificate: ')}."
    else:
        yield verdict(run.certificate)
        yield condition_table(run.certificate.conditions)
        if run.certificate.holds and run.comparison is not None:
            yield bound_table(run.certificate, run.comparison)
            yield run_sentence(run.comparison)
        yield constant_table(run.certificate)
    if run.tube is not None:
        yield tube_sentence(run.tube)
        if run.tube.exists:
            yield tube_table(run.tube)
        yield proved_sentence(run.tube)
        if run.tube.proof is not None and run.tube.proof.exists:
            yield tube_table(run.tube.proof)
    elif "tube" in run.missing:
        yield f"{run.missing['tube'][0].upper()}{run.missing['tube'][1:]}."
    elif run.certificate is None or not run.certificate.holds:
        yield "`--tube` asks less: it bounds the errors of all motions along this run's reference."
    if run.rate is not None:
        yield rate_sentence(run.rate)
    if run.thesis_bounds:
        yield PRINTED
        yield thesis_table(run)


def verdict(certificate: Certificate) -> str:
    """Whether a region is certified, and if not, what fails."""
    if certificate.holds:
        return (
            "Holds: from every error in the region, with any weights that the update can reach and any force within d, "
            "the sampled loop never leaves it and ends up in the bound. M, C and gravity are bounded over "
            f"{len(certificate.boxes.cover(certificate.region.box).nu)} boxes of postures that hold all it can reach."
        )
    failed = [c for c in certificate.conditions if not c.holds]
    why = "; ".join(f"{c.name}: {side(c.value)} is not {c.need} {side(c.limit)}" for c in failed)
    none = "No region was found. At the one nearest to it"
    where = "The region asked for is not shown to be invariant" if certificate.asked else none
    return f"FAILS. {where}: {why}. That proves nothing against the loop. What would help: {certificate.remedy}."


def side(value: float) -> str:
    """One side of a condition."""
    if math.isnan(value):
        return "no number"
    if math.isinf(value):
        return "infinity" if value > 0 else "-infinity"
    return f"{'-' if value < 0 else ''}{number(abs(value))}"


def condition_table(conditions: Iterable[Condition]) -> Table:
    """A row per condition."""
    columns = words("condition", False), Column("is"), Column("limit"), words("", False), words("what it says")
    rows = (
        row_of(
            c.name,
            side(c.value),
            f"{'<' if c.need == 'below' else '>'} {side(c.limit)}",
            "yes" if c.holds else Cell("NO", "bad"),
            c.words,
        )
        for c in conditions
    )
    return Table("Conditions", columns, tuple(rows))


def bound_table(certificate: Certificate, run: Comparison) -> Table:
    """Region, ultimate bound, and what the run had at most over its last half, in the units of the errors."""
    columns = words("largest", False), Column("region"), Column("bound"), Column("run, last half")
    return Table("Region and bound", columns, tuple(bound_rows(certificate, run)))


def bound_rows(certificate: Certificate, run: Comparison) -> Iterator[Row]:
    """See `bound_table`."""
    region, bound, last = certificate.region, certificate.bound, run.last
    names = certificate.boxes.loop.robot.velocity_names
    yield row_of("pose, size a [m]", *map(number, (region.box.pose, bound.box.pose, last.pose)))
    for label, name in (("|ex| [m]", "ex"), ("|ey| [m]", "ey"), ("|ephi| [rad]", "heading")):
        yield row_of(f"  {label}", number(getattr(region.reach, name)), number(getattr(bound.reach, name)), "")
    if len(region.joints):
        yield row_of("arm, size b", *map(number, (region.box.arm, bound.box.arm, last.arm)))
        for name, *values in zip(names[2:], region.joints, bound.joints, strict=True):
            yield row_of(f"  |e| {name} [rad or m]", *map(number, values), "")
    yield row_of("velocity, s'Ms/2 [J]", *map(number, (region.box.energy, bound.box.energy, last.energy)))
    for name, *values in zip(names, region.velocity, bound.velocity, strict=True):
        yield row_of(f"  |s| {name} [SI]", *map(number, values), "")
    for i, network in certificate.boxes.networks.items():
        for letter, most, largest in zip("WV", (network.W, network.V), run.weights[i], strict=True):
            if most:
                yield row_of(f"weights |{letter}|, {NAMES[i]}", *map(number, (most, most, largest)))


def run_sentence(run: Comparison) -> str:
    """How the run went beside its region."""
    if math.isnan(run.enters):
        return "The run never was inside of the region: nothing is guaranteed of it."
    if not run.covered:
        return "The run's weights are beyond the bounds, from before it was in the region: nothing is guaranteed."
    outside = f"starts outside of the region, is inside at {run.enters:.3g} s"
    begins = "starts inside of the region" if run.starts else outside
    stays = "and stays" if run.stays else "and LEAVES IT: the certificate is violated"
    settled = "not within the run" if math.isnan(run.settles) else f"at {run.settles:.3g} s"
    return f"The run {begins} {stays}; inside of the bound for good {settled}."


def constant_table(certificate: Certificate) -> Table:
    """A row per constant, with its source, and beside what is bounded how far it is from the worst that was sampled."""
    columns = words("constant"), Column("value", fold=True), *map(words, ("unit", "source", "what it is"))
    rows = (
        row_of(
            c.name,
            side(c.value) if math.isfinite(c.value) else "none",
            c.unit,
            c.source,
            c.words if c.loose is None else f"{c.words} ({c.loose:.3g} times off what samples have)",
        )
        for c in certificate.constants
    )
    return Table("Constants", columns, tuple(rows))


def rate_sentence(rate: Rate) -> str:
    """The condition on the learning rates, in words."""
    left = rate.limit.min()
    room = "more than 10000" if math.isinf(left) else number(left)
    return (
        f"Learning rate (discrete time, linearised): {'stable' if rate.stable else 'UNSTABLE'}; spectral radius of a "
        f"control period {rate.radius.max():.6f}, {rate.without.max():.6f} without the learner; one update is at most "
        f"{100 * rate.share.max():.3g} % of the gain; rates may be {room} times as large; leakage kappa F |s| at most "
        f"{number(rate.leak.max())} per sample, limit 2."
    )


def tube_sentence(tube: Tube) -> str:
    """Whether there is a tube along the reference, what it counts with, or what is in the way."""
    psi = f"at most {100 * tube.share.max():.3g} % of the largest Psi"
    late = f", commands {tube.late} periods late" if tube.late else ""
    if tube.exists:
        left = "more than 1000" if math.isinf(tube.bears) else number(tube.bears)
        bears = f" It bears {left} times such errors." if tube.share.max() > RIGHT else ""
        return (
            f"Tube along this reference: holds from {tube.start:.3g} s on. A motion that is where the run was then, "
            f"with errors of Psi no larger than the run's ({psi}{late}), stays within these bounds.{bears} "
            f"{pushes_sentence(tube)} Motors give at most {100 * tube.torque.max(initial=0.0):.3g} % of their limits."
        )
    if math.isfinite(tube.start):
        return f"Tube along this reference: NONE: a motor may be asked for {tube.torque.max():.3g} times its limit."
    if tube.bears == 0.0:
        worst = tube.integrator[-len(tube.share) :].max()
        return (
            "Tube along this reference: NONE, and a better estimate of Psi gives none: within a period the "
            f"simulated robot moved otherwise than dry friction at its sample says, by {number(worst)} of a velocity."
        )
    return (
        f"Tube along this reference: NONE: with the run's errors of Psi ({psi}{late}) nothing is bounded; "
        f"{number(tube.bears)} times these would have one in the run's second half."
    )


def pushes_sentence(tube: Tube) -> str:
    """Under which pushes there still is a tube."""
    if not any(tube.pushes.values()):
        return "It bears no pushes but the run's, so it is of one motion."
    each = ", ".join(f"{name} {number(most)}" for name, most in tube.pushes.items())
    return f"It bears pushes of up to these sizes, all at once [N, N m]: {each}."


def proved_sentence(tube: Tube) -> str:
    """From when on the learner's error of Psi is proved, not taken from the run, or why it is not."""
    proof = tube.proof
    if proof is None:
        return f"That the errors of Psi stay the run's is not proved: {tube.unproved}."
    most = float(proof.share.max())
    psi = f"{most:.3g} times the largest Psi" if most > 10 else f"{100 * most:.3g} % of the largest Psi"
    if math.isinf(proof.start):
        nothing = (
            f"those that are, {psi}, leave nothing bounded" if math.isfinite(proof.share.max()) else "none are bounded"
        )
        return f"That the errors of Psi stay the run's is not proved: {nothing}; {proof.blame}."
    if not proof.exists:
        return f"With errors of Psi that are proved a motor may be asked for {proof.torque.max():.3g} times its limit."
    return (
        f"Proved from {proof.start:.3g} s on, for every motion that is then where the run was: the learner's error of "
        f"Psi is at most {psi}, and these bounds hold. {pushes_sentence(proof)} {proof.note}Assumed: the robot of the "
        f"run, and noise of velocities of at most {LARGEST_NOISE:g} standard deviations, which no simulated sensor "
        "exceeds. Taken from the run are the size of rounding and the error of its integrator."
    )


def tube_table(tube: Tube) -> Table:
    """Largest error over the tube and at its end, beside the run's."""
    columns = words("largest [m, rad]", False), Column("tube"), Column("run"), Column("tube, at the end")
    rows = zip(tube.names, tube.size.max(axis=0), tube.reached.max(axis=0), tube.size[-1], strict=True)
    return Table("Errors along the reference", columns, tuple(row_of(name, *map(number, rest)) for name, *rest in rows))


def thesis_table(run: CertifiedRun) -> Table:
    """The thesis's own bounds, labelled as what they are."""
    bounds = run.thesis_bounds.values()
    rows = {
        "|z| or |r| at last, (3.59), (3.62)": [number(one.error) for one in bounds],
        "  the run's largest over its last half": [number(one.largest) for one in bounds],
        "  half-width with both braces (gap a)": [number(one.half_width) for one in bounds],
        "|Ztilde| at last, (3.60), (3.63)": [number(one.weights) for one in bounds],
        "  but V may grow at any |Ztilde|": ["no bound" for _ in bounds],
        "Kz > C2, C5 (3.51), (3.52)": [
            f"{side(one.robust)} > {side(one.C[2])}: {'yes' if one.gain_holds else 'NO'}" for one in bounds
        ],
    }
    columns = words("", False), *(Column(NAMES[i]) for i in run.thesis_bounds)
    return Table(PRINTED, columns, tuple(row_of(label, *cells) for label, cells in rows.items()))
