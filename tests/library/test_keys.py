"""API keys in the store: the stored fields, and the recognition of keys."""

from __future__ import annotations

import hashlib

import pytest

from unbend import Library
from unbend.errors import NotFoundError, ParameterError


@pytest.fixture
def library(tmp_path):
    with Library(str(tmp_path / "a.db")) as opened:
        yield opened


def made(library: Library, name: str = "a key", scope: str = "read"):
    return library.keys.create(name, scope)


def found(library: Library, text: str):
    return library.keys.find(text)


def test_a_key_is_recognised_by_its_text_and_only_a_hash_of_its_secret_is_stored(library):
    record, text = made(library, "scanner", "write")
    assert (record.name, record.scope, record.revoked_at) == ("scanner", "write", None)
    assert found(library, text) == record
    prefix, key_id, secret = text.split("_", 2)
    assert (prefix, key_id) == ("unbend", record.id)
    assert len(secret) == 43  # 256 bits in base64
    with library.store.read() as connection:
        (row,) = connection.exec_driver_sql("SELECT * FROM api_keys").mappings().all()
    assert row["sha256"] == hashlib.sha256(secret.encode()).hexdigest()
    assert all(secret not in str(value) for value in row.values())


def test_no_two_keys_are_the_same(library):
    texts = [made(library)[1] for _ in range(20)]
    assert len({text.split("_", 2)[1] for text in texts}) == 20
    assert len({text.split("_", 2)[2] for text in texts}) == 20


def test_a_key_that_differs_in_one_character_is_not_recognised(library):
    record, text = made(library)
    other, other_text = made(library)
    secret, other_secret = (each.split("_", 2)[2] for each in (text, other_text))
    wrong = [text[:place] + ("x" if text[place] != "x" else "y") + text[place + 1 :] for place in range(len(text))]
    wrong += [
        "",
        "_",
        "__",
        "unbend",
        f"unbend_{record.id}",
        f"unbend_{record.id}_",
        f"unbend_{record.id}_{other_secret}",
    ]
    wrong += [
        f"unbend_{other.id}_{secret}",
        f"unbend__{secret}",
        text + " ",
        text + "x",
        text.upper(),
        secret,
        "é\udc80",
    ]
    assert [each for each in wrong if found(library, each)] == []


def test_keys_are_listed_in_order_and_a_revoked_key_is_not_recognised(library):
    first, text = made(library, "first")
    second, _ = made(library, "second", "write")
    assert library.keys.all() == [first, second]
    revoked = library.keys.revoke(first.id)
    assert revoked.revoked_at >= first.created_at
    assert library.keys.revoke(first.id) == revoked
    assert library.keys.all() == [revoked, second]
    assert library.keys.are_required()
    library.keys.revoke(second.id)
    assert not library.keys.are_required()
    assert found(library, text) is None


def test_revoking_an_unknown_key_raises_not_found(library):
    with pytest.raises(NotFoundError, match="no key nobody"):
        library.keys.revoke("nobody")


@pytest.mark.parametrize(("name", "scope"), [("", "read"), ("x" * 201, "read"), ("two\nlines", "read"), ("x", "god")])
def test_a_key_with_an_invalid_name_or_scope_is_refused(library, name, scope):
    with pytest.raises(ParameterError):
        made(library, name, scope)
