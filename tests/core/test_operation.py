"""What people call an operation."""

from __future__ import annotations

from upwash.core.operation import title_of, titles


def test_an_operation_has_its_services_title_and_its_method_only_where_two_have_one_title() -> None:
    heavy, light = "detector.process_photo[heavy]", "detector.process_photo[light]"
    assert title_of(heavy) == "detector (heavy)"
    assert titles([heavy, light]) == {heavy: "detector (heavy)", light: "detector (light)"}
    assert titles(["leaf_counter.count_leaves", "leaf_counter.area"]) == {
        "leaf_counter.count_leaves": "leaf counter count leaves",
        "leaf_counter.area": "leaf counter area",
    }
