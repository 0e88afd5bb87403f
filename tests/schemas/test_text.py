"""Text that is fit to be shown: nothing commands a terminal, and no credential is in it."""

from __future__ import annotations

import json
import pickle
import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.errors import InputError, LakeError, RecordError, check_address
from schemas.text import concealed, escaped, one_line, shown
from warehouse.storage.refusals import StoreAway
from warehouse.tables.delta import LogError

BIDI = "\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"


@given(st.text())
def test_what_is_shown_commands_no_terminal_and_says_the_same_in_json(text: str) -> None:
    made = escaped(text)
    assert not [c for c in made if unicodedata.category(c) in ("Cc", "Zl", "Zp", "Cs") and c not in "\n\t"]
    assert not set(made) & set(BIDI)
    assert escaped(made) == made
    made.encode()
    document = json.dumps({"a": text}, ensure_ascii=False)
    if not any(unicodedata.category(c) == "Cs" for c in text):
        assert json.loads(escaped(document)) == {"a": text}


def test_a_terminals_commands_are_written_out() -> None:
    said = "\x1b[31mred\x1b]0;title\x07 \x9b2J \r\x08 \x7f \U000e0041 é 中 👩‍🚀\t."
    assert escaped(said) == ("\\u001b[31mred\\u001b]0;title\\u0007 \\u009b2J \\u000d\\u0008 \\u007f \\udb40\\udc41 é 中 👩‍🚀\t.")


SECRET = "wJalrXUtnFEMI/K7MDENG+bPxRfiCYEXAMPLEKEY"
PLACES = [
    f"s3://AKIA55:{SECRET}@bucket/lake",
    f"S3://AKIA55:{SECRET}@bucket/lake",
    f"s3:/AKIA55:{SECRET}@bucket/lake",
    f"s3:AKIA55:{SECRET}@bucket/lake",
    f"s3://AKIA55:{SECRET}",
    f"s3://bucket/lake?AWSAccessKeyId=AKIA55&Signature={SECRET}&x=1",
    f"s3://bucket/lake?k={SECRET}",
    f"https://AKIA55:{SECRET}@store.example:9000/bucket",
    f"http:/AKIA55:{SECRET}@store.example/bucket",
    f"https://store.example/bucket?X-Amz-Credential=AKIA55&X-Amz-Signature={SECRET}",
    f"postgresql+asyncpg://AKIA55:{SECRET}@127.0.0.1/prefect",
    f"aws_secret_access_key={SECRET}",
]


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("around", ["{}", "'{}'", "cannot open {}: no such file", '("{}",)', "at {}."])
def test_credentials_of_an_address_are_not_shown(place: str, around: str) -> None:
    said = around.format(place)
    made = concealed(said)
    for piece in ("AKIA55", "wJal", "K7MD", "EXAMPLEKEY"):
        assert piece not in made
    assert concealed(made) == made
    head, tail = around.split("{}")
    assert made.startswith(head)
    assert made.endswith(tail.lstrip(":"))


@pytest.mark.parametrize(
    "said",
    [
        "s3://bucket/lake/staged/a~2fb@capture@0f@1.parquet: cannot be read",
        "http://127.0.0.1:4200/runs/flow-run/1?tab=logs",
        "http://[::1]:4200/api",
        "s3://bucket: --scans: is a whole bucket; give s3://bucket/prefix",
        "a:/b:c/d is a folder, @home; 12:30",
        "exports.mjcf.engine=3, secrets of 4",
    ],
)
def test_what_holds_no_credentials_stays_as_it_is(said: str) -> None:
    assert shown(said) == said


def test_secrets_of_the_environment_are_not_shown_wherever_they_stand(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", SECRET)
    assert one_line(f"denied: {SECRET}\n for you") == "denied: ... for you"


@pytest.mark.parametrize(
    "error",
    [
        InputError(f"a\nb\x1b[2J {PLACES[0]}", f"\x1b{SECRET[:0]}field", f"{PLACES[5]} \u202e", f"see {PLACES[7]}"),
        RecordError("table", "\x1b[2J", "field\n", PLACES[0]),
        LakeError(f"\x1b[2J\n{PLACES[0]}"),
        LogError(f"{PLACES[0]}/tables/x", f"\x1b[2J {PLACES[7]}\n at delta"),
        StoreAway(PLACES[0], PLACES[7]),
    ],
    ids=lambda error: type(error).__name__,
)
def test_errors_are_one_line_without_credentials_here_and_in_another_process(error: LakeError) -> None:
    for one in (error, pickle.loads(pickle.dumps(error))):
        assert type(one) is type(error)
        text = str(one)
        assert "AKIA55" not in text + repr(one)
        assert "wJal" not in text + repr(one)
        assert not [c for c in text if unicodedata.category(c) == "Cc"]


@pytest.mark.parametrize("place", PLACES[:-1])
def test_an_address_with_credentials_is_refused_without_saying_them(place: str) -> None:
    with pytest.raises(InputError, match="the address carries credentials; give them by the environment") as caught:
        check_address(place, "--lake")
    assert "wJal" not in str(caught.value)


@pytest.mark.parametrize(
    "value",
    [
        'see "http://127.0.0.1:4200" now', 'password="x"', 'signature="a,b"', '"https://host:pw"', "http://127.0.0.1:4200\nnext line",
        "a\\b=c s3://KEY:SECRET@bucket/lake\\", 'token "s3://KEY:SECRET@bucket" and more',
    ],
)  # fmt: skip
def test_json_stays_what_it_says_but_for_credentials(value: str) -> None:
    """What is printed is JSON text as a whole: its quotes are escaped."""
    read = json.loads(shown(json.dumps({"error": value})))
    assert list(read) == ["error"]
    assert read["error"] == concealed(value)
    assert "SECRET" not in read["error"]


def test_folders_may_be_named_like_settings() -> None:
    check_address("/data/signature=v1/aws_lake=1")
    for address in ("s3://KEY:SECRET@bucket/lake", "s3:KEY:SECRET@bucket", "https://store/x?X-Amz-Signature=abcdef"):
        with pytest.raises(InputError, match="carries credentials"):
            check_address(address)
