# SPDX-License-Identifier: Apache-2.0
"""The sensor line: ASCII sentences with a checksum, as in NMEA 0183.

Host to microcontroller, microcontroller to host:

    $R*52           $S,<seq>,<micros>,<pot_x>,<pot_y>,<piezo>,<depot>*<checksum>
    $B*42           the same, once the depot has been told to release a ball

Counts are decimal; the checksum is the XOR of the bytes between `$` and `*`, in two hexadecimal digits; a sentence ends
with a line feed. The potentiometers are sampled when the request's line feed arrives.
"""

from dataclasses import dataclass

READ, SUPPLY = "R", "B"


@dataclass(frozen=True)
class SensorSample:
    """One answer of the sensor line.

    Attributes:
        sequence: 0..65535, grows by one per answer.
        micros: microseconds of the microcontroller's clock when the potentiometers were sampled, modulo 2^32.
        pot_x, pot_y: counts of the potentiometers' converters.
        piezo: hits since power-up, modulo 65536.
        depot: balls released since power-up, modulo 65536.
    """

    sequence: int
    micros: int
    pot_x: int
    pot_y: int
    piezo: int
    depot: int


def sentence(body: str) -> bytes:
    """A body with frame and checksum."""
    value = 0
    for byte in body.encode("ascii"):
        value ^= byte
    return f"${body}*{value:02X}\n".encode("ascii")


def unpack(line: bytes) -> str | None:
    """The body of a sentence, or None where frame or checksum are wrong."""
    text = line.strip()
    if len(text) < 4 or text[:1] != b"$" or text[-3:-2] != b"*" or not text.isascii():
        return None
    body = text[1:-3].decode("ascii")
    return body if sentence(body).strip().upper() == text.upper() else None


def write_sample(sample: SensorSample) -> bytes:
    """A sample as a sentence."""
    s = sample
    return sentence(f"S,{s.sequence},{s.micros},{s.pot_x},{s.pot_y},{s.piezo},{s.depot}")


def read_sample(line: bytes) -> SensorSample | None:
    """The sample in a line, or None where the line holds none."""
    body = unpack(line)
    if body is None:
        return None
    fields = body.split(",")
    if len(fields) != 7 or fields[0] != "S":
        return None
    try:
        return SensorSample(*(int(field) for field in fields[1:]))
    except ValueError:
        return None
