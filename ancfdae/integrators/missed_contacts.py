"""Replaces the outcome of a finished run whose steps passed over a contact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ancfdae.equations.contact_record import ContactRecord, MissedContact
from ancfdae.equations.solution import Solution
from ancfdae.errors.outcomes import Verdict


def with_contacts(run: Solution, contacts: ContactRecord, whole: bool = True) -> Solution:
    """Return `run`, with the outcome MISSED_CONTACT if its steps passed over a contact.

    `contacts` records the states of the run, which may be a part of a longer one. Contacts are
    judged only if the run is `whole`, or the last part.
    """
    if not run.outcome.success:
        return run
    contacts.follow(run.t, run.q, run.v)
    return refused(run, contacts.missed() if whole else None)


def refused(run: Solution, missed: MissedContact | None) -> Solution:
    """Return `run` with the outcome that it missed a contact; unchanged if `missed` is None."""
    if missed is None:
        return run
    step = max(int(np.searchsorted(run.t, missed.time, side="right")) - 1, 0) // run.degree
    verdict, advice = Verdict.MISSED_CONTACT, missed.advice
    outcome = replace(run.outcome, verdict=verdict, time=missed.time, step=step, advice=advice)
    return replace(run, outcome=outcome)
