"""SCPI framing, after IEEE 488.2 and SCPI-1999."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.scpi import (
    BlockParser,
    ErrorEntry,
    ErrorQueue,
    MessageSplitter,
    ScpiSyntaxError,
    block_argument,
    encode_block,
    event_status_bit,
    matches,
    parse_error_entry,
    parse_message,
    split_answers,
)
from drivers.scpi_values import (
    parse_channel_list,
    parse_number,
    parse_word,
    same_arb,
    same_boolean,
    same_number,
    same_word,
)


def cut(data: bytes, sizes: list[int]) -> list[bytes]:
    pieces, at = [], 0
    for size in sizes:
        pieces.append(data[at : at + size])
        at += size
    return [*pieces, data[at:]]


def fed_byte_by_byte(wire: bytes) -> BlockParser:
    parser = BlockParser()
    for at in range(len(wire)):
        parser.feed(wire[at : at + 1])
    return parser


def test_a_block_says_how_many_digits_its_length_has():
    assert encode_block(b"hello") == b"#15hello"
    assert encode_block(b"x" * 12) == b"#212" + b"x" * 12
    assert encode_block(b"hello", digits=9) == b"#9000000005hello"


@given(st.binary(max_size=300), st.lists(st.integers(1, 40), max_size=20))
def test_a_block_comes_back_whole_however_it_is_cut(payload, sizes):
    wire = encode_block(payload)
    parser = BlockParser()
    for piece in cut(wire, sizes):
        while piece:
            now, piece = piece[: parser.needed], piece[parser.needed :]
            parser.feed(now)
    assert parser.needed == 0
    assert parser.payload == payload


@pytest.mark.parametrize("wire", [b"15", b"#0", b"#A", b"#2x"])
def test_what_is_no_block_is_refused_as_invalid_block_data(wire):
    with pytest.raises(ScpiSyntaxError) as refused:
        fed_byte_by_byte(wire)
    assert refused.value.code == -161


@given(
    st.lists(st.binary(min_size=1, max_size=60), min_size=1, max_size=4),
    st.lists(st.integers(1, 30), max_size=20),
)
def test_messages_with_blocks_survive_any_packets(payloads, sizes):
    wire = b"".join(b"DATA:ARB:DAC x," + encode_block(p) + b"\nOUTP 1\r\n" for p in payloads)
    splitter = MessageSplitter()
    messages = [m for piece in cut(wire, sizes) for m in splitter.feed(piece)]
    assert messages[1::2] == [b"OUTP 1"] * len(payloads)
    for message, payload in zip(messages[0::2], payloads, strict=True):
        (unit,) = parse_message(message)
        assert block_argument(unit.arguments[1]) == payload


@given(st.text(alphabet="AB1 ;:,?#'\"\n\r\t()@*", max_size=80), st.lists(st.integers(1, 9)))
def test_splitting_does_not_depend_on_the_packets(text, sizes):
    wire = text.encode() + b"\n"
    whole, pieces = MessageSplitter(), MessageSplitter()
    together = whole.feed(wire)
    assert [m for piece in cut(wire, sizes) for m in pieces.feed(piece)] == together


def test_a_line_feed_inside_a_block_ends_nothing_and_one_inside_an_open_quote_does():
    splitter = MessageSplitter()
    assert splitter.feed(b"A #12\n\n\n") == [b"A #12\n\n"]
    assert splitter.feed(b"B 'open\nC?\n") == [b"B 'open", b"C?"]


def test_compound_headers_follow_the_path_of_the_one_before():
    units = parse_message(b"SOUR1:VOLT:HIGH 1;LOW -1;*CLS;OFFS?;:OUTP ON;STAT?")
    assert [unit.header for unit in units] == [
        "SOUR1:VOLT:HIGH",
        "SOUR1:VOLT:LOW",
        "*CLS",
        "SOUR1:VOLT:OFFS",
        "OUTP",
        "STAT",
    ]
    assert [unit.query for unit in units] == [False, False, False, True, False, True]


def test_commas_and_semicolons_inside_quotes_and_lists_separate_nothing():
    (unit,) = parse_message(b'CONF:CHAN:RANG (@1,2),"a;b,c"')
    assert unit.arguments == (b"(@1,2)", b'"a;b,c"')
    assert split_answers('1;"a;b";ON') == ["1", '"a;b"', "ON"]


@pytest.mark.parametrize(
    "header", ["VOLT:HIGH", "voltage:high", "SOUR:VOLT:LEV:HIGH", "SOURce1:VOLTage:LEVel:HIGH"]
)
def test_short_long_and_optional_forms_are_one_command(header):
    assert matches("[SOURce[1]:]VOLTage[:LEVel]:HIGH", header)


@pytest.mark.parametrize("header", ["VOLTA:HIGH", "SOUR2:VOLT:HIGH", "VOLT:HI", "VOLT"])
def test_forms_between_short_and_long_are_not(header):
    assert not matches("[SOURce[1]:]VOLTage[:LEVel]:HIGH", header)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1.5", 1.5),
        ("-.5E-3", -0.0005),
        ("#HFF", 255.0),
        ("#B101", 5.0),
        ("250 mV", 0.25),
        ("5kHz", 5000.0),
        ("2MHZ", 2e6),
        ("INF", 9.9e37),
        ("infinity", 9.9e37),
    ],
)
def test_numbers_in_any_format(text, value):
    assert parse_number(text) == pytest.approx(value)


def test_wrong_parameters_have_their_scpi_numbers():
    codes = []
    for attempt in (
        lambda: parse_number("ten"),
        lambda: parse_number("5 furlongs"),
        lambda: parse_word("MAYBE", ("NORMal", "SWAPped")),
        lambda: parse_channel_list("1,2"),
    ):
        with pytest.raises(ScpiSyntaxError) as refused:
            attempt()
        codes.append(refused.value.code)
    assert codes == [-104, -131, -224, -171]


def test_channel_lists_hold_single_channels_and_spans():
    assert parse_channel_list("(@1, 3:5)") == [1, 3, 4, 5]


def test_answers_agree_whatever_their_dress():
    assert same_number(-10.0, "-1.00000000000000E+01")
    assert same_number(9.9e37, "+9.9E+37")
    assert same_boolean(True, "ON")
    assert same_boolean(False, "+0")
    assert same_word("SWAP", "swapped")
    assert same_arb("SWEEP", '"INT:\\SWEEP.arb"')
    assert not same_number(-10.0, "-9.99")
    assert not same_number(9.9e37, "50")
    assert not same_boolean(True, "0")
    assert not same_word("POS", "NEG")
    assert not same_arb("SWEEP1", '"SWEEP"')


def test_the_twenty_first_error_turns_the_last_into_an_overflow():
    queue = ErrorQueue(20)
    for number in range(21):
        queue.push(ErrorEntry(-222, f"number {number}"))
    codes = [queue.pop().code for _ in range(21)]
    assert codes == [-222] * 19 + [-350, 0]


@pytest.mark.parametrize(("code", "bit"), [(-113, 5), (-221, 4), (-350, 3), (786, 3), (-410, 2)])
def test_each_class_of_error_has_its_event_status_bit(code, bit):
    assert event_status_bit(code) == 1 << bit


@given(st.integers(-999, 999), st.text("abc ;,", max_size=20))
def test_an_error_entry_reads_back(code, text):
    assert parse_error_entry(str(ErrorEntry(code, text))) == ErrorEntry(code, text)
