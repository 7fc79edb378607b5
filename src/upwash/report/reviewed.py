"""Findings as their reviews have them: the one place that leaves rejected ones out and replaces labels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from upwash.report.numbering import FlightFindings, Numbered, PlacedFinding, numbered
from upwash.report.reviews import FindingKey, Ranked
from upwash.support.text import counted, printable

_MOST_NAMED = 8  # reviewers or numbers in a sentence


@dataclass(frozen=True, slots=True)
class ReviewTally:
    """How many of the findings were reviewed; `remarks` are sentences about several reviewers and odd entries.

    `words` is such as "7 of 9 reviewed, 2 rejected", and empty without reviews.
    """

    found: int
    reviewed: int
    rejected: int
    words: str
    remarks: Sequence[str]


@dataclass(frozen=True, slots=True)
class ReviewedFindings:
    """Findings of flights as objects with their reviews, in the order of their numbers.

    `everything` has rejected objects too. `positions` has the place of each finding's object there, by flight.
    """

    everything: Sequence[PlacedFinding]
    positions: Sequence[Sequence[int]]
    flights: Sequence[FlightFindings]

    @property
    def objects(self) -> list[PlacedFinding]:
        """Those that are not rejected."""
        return [each for each in self.everything if not each.is_rejected]

    def of_finding(self, flight: int, index: int) -> PlacedFinding:
        """The object of that finding of the flight."""
        return self.everything[self.positions[flight][index]]

    def of_flight(self, flight: int) -> ReviewedFindings:
        """What was found on that flight, which is one of several of the same drone."""
        own = [each for each in self.everything if each.first[0] == flight]
        return ReviewedFindings(own, (), [self.flights[flight]])

    @property
    def tally(self) -> ReviewTally:
        """How much of it is reviewed."""
        reviewed = sum(each.is_reviewed for each in self.everything)
        rejected = sum(each.is_rejected for each in self.everything)
        remarks = [
            *_about_reviewers(self.everything),
            *(remark for flight in self.flights for remark in _about_file(flight)),
        ]
        words = f"{reviewed} of {len(self.everything)} reviewed{f', {rejected} rejected' if rejected else ''}"
        is_told = remarks or any(flight.reviews.by_finding for flight in self.flights)
        return ReviewTally(len(self.everything), reviewed, rejected, words if is_told else "", remarks)


def reviewed(flights: Sequence[FlightFindings]) -> ReviewedFindings:
    """The findings of the flights under their numbers, each object with the reviews of all its sightings.

    A number stays when other objects are rejected. The last review of an object counts.
    """
    return with_reviews(numbered(flights), flights)


def with_reviews(found: Numbered, flights: Sequence[FlightFindings]) -> ReviewedFindings:
    """The same of findings that are numbered already."""
    reviews: dict[int, list[Ranked]] = {}
    for flight, positions in zip(flights, found.positions, strict=True):
        if not flight.reviews.by_finding:
            continue
        for finding, position in zip(flight.found, positions, strict=True):
            if (own := flight.reviews.by_finding.get(finding.key)) is not None:
                reviews.setdefault(position, []).extend(own)
    everything = [
        _with_reviews(each, reviews.get(position, ())) for position, each in enumerate(found.objects)
    ]
    return ReviewedFindings(everything, found.positions, flights)


def _with_reviews(found: PlacedFinding, ranked: Sequence[Ranked]) -> PlacedFinding:
    if not ranked:
        return found
    reviews = [each.review for each in sorted(ranked, key=lambda each: each.rank)]
    after = replace(found, reviews=reviews)
    return replace(after, finding=after.sighting(found.finding))


def _about_reviewers(found: Sequence[PlacedFinding]) -> list[str]:
    """Who reviewed how many, if several did, and where they contradict each other."""
    counts = Counter(name for each in found for name in each.verdicts)
    if len(counts) < 2:
        return []
    told = [f"{name or 'without a name'} {number}" for name, number in counts.most_common(_MOST_NAMED)]
    if others := len(counts) - len(told):
        told.append(f"{others} others")
    remarks = [f"{counted(len(counts), 'reviewer')} ({', '.join(told)}): the last verdict counts"]
    if disputed := [str(each.number) for each in found if each.is_disputed]:
        named = ", ".join(disputed[:_MOST_NAMED]) + (" and others" if len(disputed) > _MOST_NAMED else "")
        remarks.append(f"reviewers contradict each other about {counted(len(disputed), 'finding')}: {named}")
    return remarks


def _about_file(flight: FlightFindings) -> list[str]:
    """What could not be read of a flight's reviews, and how many are of no finding there."""
    known: Mapping[FindingKey, Sequence[Ranked]] = flight.reviews.by_finding
    unknown = len(known.keys() - {finding.key for finding in flight.found}) if known else 0
    if not unknown:
        return list(flight.reviews.remarks)
    are = "is" if unknown == 1 else "are"
    return [
        *flight.reviews.remarks,
        f"{counted(unknown, 'review')} in {printable(flight.reviews.file)} {are} about no finding of "
        f"{printable(flight.log)}",
    ]
