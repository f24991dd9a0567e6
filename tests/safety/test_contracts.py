"""Every primitive has its contract, and what it names is checked by somebody. Paper IV-C."""

from __future__ import annotations

import pytest

from safety.constraints import RULES
from safety.contracts import CONTRACTS
from safety.vocabulary import PRIMITIVE_OF, Primitive


@pytest.mark.parametrize("primitive", list(Primitive))
def test_a_contract_names_every_rule_once(primitive: Primitive) -> None:
    contract = CONTRACTS[primitive]
    named = [*contract.preconditions, *contract.invariants]
    rules = {rule.name for rule in RULES}
    assert len(named) == len(set(named))
    assert set(named) == rules - ({"input_confidence"} if primitive is Primitive.RETURN else set())


@pytest.mark.parametrize("primitive", list(Primitive))
def test_invariants_are_what_is_monitored(primitive: Primitive) -> None:
    assert set(CONTRACTS[primitive].invariants) == {rule.name for rule in RULES if rule.hard}


def test_scans_end_facing_the_operator() -> None:
    """X9"""
    assert [p for p in Primitive if "facing_operator" in CONTRACTS[p].postconditions] == [
        p for p in Primitive if p.is_scan
    ]
    assert set(PRIMITIVE_OF.values()) | {Primitive.RETURN} == set(CONTRACTS)
