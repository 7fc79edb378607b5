"""Orders to a daemon of the same machine: the kernel names both ends."""

from __future__ import annotations

import asyncio
import os

import pytest

from upwash.errors import UpwashError, UsageError
from upwash.real.link import orders
from upwash.real.link.orders import Obeyed, give_order, taking_orders

STRANGER = 12345  # a user


async def test_an_order_is_obeyed_with_the_name_of_who_gave_it_and_answered() -> None:
    heard: list[tuple[str, str]] = []

    async def obey(order: str, by: str) -> Obeyed:
        heard.append((order, by))
        return Obeyed({"keys": "no such file"}, "server.toml")

    async with taking_orders(obey):
        obeyed = await asyncio.to_thread(give_order, os.getpid(), "reload")
    assert obeyed.refused == {"keys": "no such file"}
    ((order, by),) = heard
    assert order == "reload"
    assert by.startswith(f"process {os.getpid()} of user ")
    with pytest.raises(UsageError, match=r"takes no orders .*wait until it is ready"):
        await asyncio.to_thread(give_order, os.getpid(), "reload")


async def test_a_process_that_answers_in_the_place_of_another_is_not_believed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def obey(_order: str, _by: str) -> Obeyed:
        return Obeyed({}, "")

    async with taking_orders(obey):
        there = orders._address(os.getpid())
        monkeypatch.setattr(orders, "_address", lambda _: there)
        with pytest.raises(UsageError, match="another process answers in the place of process 1"):
            await asyncio.to_thread(give_order, 1, "reload")


async def test_another_user_is_not_obeyed(monkeypatch: pytest.MonkeyPatch) -> None:
    async def obey(_order: str, _by: str) -> Obeyed:
        raise AssertionError("it is obeyed")

    async with taking_orders(obey):
        monkeypatch.setattr(orders, "_who", lambda _: (os.getpid(), STRANGER))
        with pytest.raises(UpwashError, match="has not answered"):
            await asyncio.to_thread(give_order, os.getpid(), "reload")
