"""Photos from strangers: good ones decode, bad ones are refused for what is wrong with them."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest

from rodeo.vision.images import (
    _PNG_PASSES,
    BrokenImage,
    ImageError,
    ImageLimits,
    ImageTooLarge,
    UnsupportedImage,
    decode_image,
    image_size,
)

PHOTO = np.random.default_rng(1).integers(0, 256, (48, 64, 3), dtype=np.uint8)
FORMATS = (".jpg", ".png", ".webp")


def encoded(extension: str, image: np.ndarray = PHOTO, *options: int) -> bytes:
    return cv2.imencode(extension, image, options)[1].tobytes()


SIGNATURE = b"\x89PNG\r\n\x1a\n"


def chunk(name: bytes, content: bytes, length: int | None = None) -> bytes:
    """A PNG's chunk, which claims another length than it has where one is given."""
    told = len(content) if length is None else length
    return struct.pack(">I", told) + name + content + struct.pack(">I", zlib.crc32(name + content))


def png(*chunks: bytes, bits: int = 8, colour: int = 2, interlaced: int = 0) -> bytes:
    """A PNG of 64 x 48 of these chunks."""
    header = struct.pack(">IIBBBBB", 64, 48, bits, colour, 0, 0, interlaced)
    return SIGNATURE + chunk(b"IHDR", header) + b"".join(chunks)


PIXELS = chunk(b"IDAT", zlib.compress(b"".join(b"\0" + row.tobytes() for row in PHOTO[:, :, ::-1])))
END = chunk(b"IEND", b"")


@pytest.fixture
def no_decoder(monkeypatch: pytest.MonkeyPatch) -> None:
    """What asks OpenCV fails."""
    monkeypatch.delattr(cv2, "imdecode")


def png_claiming(width_px: int, height_px: int) -> bytes:
    """A PNG whose header tells of a size that its data does not have."""
    header = struct.pack(">IIBBBBB", width_px, height_px, 8, 2, 0, 0, 0)
    return SIGNATURE + chunk(b"IHDR", header)


@pytest.mark.parametrize("extension", FORMATS)
def test_a_photo_decodes_in_each_format(extension: str) -> None:
    data = encoded(extension)
    assert image_size(data) == (64, 48)
    assert decode_image(data).shape == (48, 64, 3)


def test_a_lossless_webp_and_a_progressive_jpeg_decode() -> None:
    assert np.array_equal(decode_image(encoded(".webp", PHOTO, cv2.IMWRITE_WEBP_QUALITY, 101)), PHOTO)
    assert decode_image(encoded(".jpg", PHOTO, cv2.IMWRITE_JPEG_PROGRESSIVE, 1)).shape == PHOTO.shape


def test_a_jpeg_of_countless_scans_is_refused_before_it_is_decoded() -> None:
    data = encoded(".jpg", PHOTO, cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
    scan = data[data.rindex(b"\xff\xda") : -2]
    with pytest.raises(ImageTooLarge) as refused:
        decode_image(data[:-2] + scan * 1000 + data[-2:])
    assert refused.value.details["scans"] > 1000


@pytest.mark.parametrize("marker", [0x00, 0x02, 0xBF, 0xC8, 0xF0, 0xFD])
def test_a_jpeg_cannot_tell_the_decoder_another_size_than_us(marker: int) -> None:
    """For who takes the marker for a segment's, what follows it tells of a small frame."""
    frame = b"\xff\xc0" + struct.pack(">HBHHB", 11, 8, 8, 8, 1) + b"\x01\x11\x00"
    hidden = bytes([0xFF, marker]) + b"\x00\x06" + b"\xff\xfe" + struct.pack(">H", 2 + len(frame)) + frame
    data = b"\xff\xd8" + hidden + encoded(".jpg")[2:]
    with pytest.raises(BrokenImage):
        decode_image(data, ImageLimits(max_pixels=100))


def test_grey_and_transparent_photos_become_colour() -> None:
    assert decode_image(encoded(".png", PHOTO[:, :, 0])).shape == PHOTO.shape
    assert decode_image(encoded(".png", np.dstack([PHOTO, PHOTO[:, :, :1]]))).shape == PHOTO.shape


def test_too_many_bytes_are_refused_before_anything_else() -> None:
    with pytest.raises(ImageTooLarge) as refused:
        decode_image(b"\0" * 101, ImageLimits(max_bytes=100))
    assert refused.value.details == {"bytes": 101, "max_bytes": 100}


@pytest.mark.parametrize("extension", FORMATS)
def test_too_many_pixels_are_refused(extension: str) -> None:
    with pytest.raises(ImageTooLarge) as refused:
        decode_image(encoded(extension), ImageLimits(max_pixels=64 * 48 - 1))
    assert refused.value.details["max_pixels"] == 64 * 48 - 1


def test_a_decompression_bomb_is_refused_by_its_header() -> None:
    with pytest.raises(ImageTooLarge):
        decode_image(png_claiming(200_000, 200_000))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"not a photo",
        b"GIF89a" + b"\0" * 50,
        b"BM" + b"\0" * 50,
        b"II*\0" + b"\0" * 50,
        b"RIFF\0\0\0\0WAVEfmt ",
        b"<svg xmlns='http://www.w3.org/2000/svg'/>",
        b"%PDF-1.7",
        b"\0\0\0\x20ftypavif" + b"\0" * 50,
        encoded(".bmp"),
        encoded(".tiff"),
    ],
)
def test_other_formats_never_reach_a_decoder(data: bytes) -> None:
    with pytest.raises(UnsupportedImage):
        decode_image(data)


@pytest.mark.parametrize(
    "data",
    [
        b"\xff\xd8",
        b"\xff\xd8\xff",
        b"\xff\xd8\xff\xff\xff\xff",
        b"\xff\xd8\x00\x00",
        b"\xff\xd8\xff\xe0\x00\x00",
        b"\xff\xd8\xff\xe0\xff\xff",
        b"\xff\xd8\xff\xd9",
        b"\xff\xd8\xff\xda\x00\x04\x00\x00",
        b"\xff\xd8\xff\xc0\x00\x0b\x08\x00\x00\x00\x00",
        b"\xff\xd8" + b"\xff\xd0" * 1000,
        b"\x89PNG\r\n\x1a\n",
        b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR\0\0",
        b"\x89PNG\r\n\x1a\n\0\0\0\x0dIDAT" + b"\0" * 20,
        png_claiming(0, 0),
        png_claiming(64, 48),
        b"RIFF\x10\0\0\0WEBP",
        b"RIFF\x10\0\0\0WEBPVP8 ",
        b"RIFF\x10\0\0\0WEBPVP8L\0\0",
        b"RIFF\x10\0\0\0WEBPVP8X\x0a\0\0\0",
        b"RIFF\x10\0\0\0WEBPALPH" + b"\0" * 30,
    ],
)
def test_a_cut_or_nonsensical_header_is_a_broken_image(data: bytes) -> None:
    with pytest.raises(BrokenImage):
        decode_image(data)


@pytest.mark.parametrize("extension", FORMATS)
def test_a_photo_cut_or_flipped_anywhere_decodes_or_is_refused(extension: str) -> None:
    """Corrupted on purpose a few hundred times: either a picture of bounded size or an ImageError."""
    data = encoded(extension)
    rng = np.random.default_rng(2)
    limits = ImageLimits(max_pixels=1_000_000)
    damaged = [data[:end] for end in range(0, len(data), max(1, len(data) // 60))]
    for _ in range(100):
        changed = bytearray(data)
        for at in rng.integers(0, len(data) if rng.random() < 0.5 else 64, 3):
            changed[at] ^= int(rng.integers(1, 256))
        damaged.append(bytes(changed))
    outcomes = set()
    for photo in damaged:
        try:
            outcomes.add(decode_image(photo, limits).ndim)
        except ImageError as error:
            outcomes.add(error.code)
    assert {"broken_image", "unsupported_image"} <= outcomes <= {
        3, "broken_image", "unsupported_image", "image_too_large"
    }  # fmt: skip


@pytest.mark.parametrize("name", [b"tEXt", b"IDAT", b"PLTE", b"fcTL"])
@pytest.mark.parametrize("length", [0xFFFFFFF0, 0x7FFFFFF0, 0x40000000, 2])
@pytest.mark.usefixtures("no_decoder")
def test_a_png_chunk_that_claims_more_than_there_is_never_reaches_the_decoder(
    name: bytes, length: int
) -> None:
    """The decoder would take so much memory: 4 GB for 42 bytes."""
    with pytest.raises(BrokenImage, match=r"longer than what is left|before its last chunk"):
        decode_image(png(chunk(name, b"x", length)))


@pytest.mark.usefixtures("no_decoder")
def test_a_png_whose_bomb_lies_behind_its_end_never_reaches_the_decoder() -> None:
    with pytest.raises(BrokenImage, match="before its pixels"):
        decode_image(png(END, chunk(b"tEXt", b"x", 0xFFFFFFF0)))


@pytest.mark.parametrize("pieces", [1, 1000])
@pytest.mark.usefixtures("no_decoder")
def test_more_pixels_than_a_png_has_never_reach_the_decoder(pieces: int) -> None:
    """It would unpack all of them: 8 MB took 7 s."""
    surplus = zlib.compress(bytes(20_000_000))
    step = len(surplus) // pieces
    parts = [chunk(b"IDAT", surplus[at : at + step]) for at in range(0, len(surplus), step)]
    with pytest.raises(BrokenImage, match="more bytes of pixels") as refused:
        decode_image(png(*parts, END))
    assert refused.value.details["allowed"] == 48 * (1 + 3 * 64)


@pytest.mark.parametrize(
    "text",
    [
        chunk(b"zTXt", b"k\0\0" + zlib.compress(bytes(100_000))),
        chunk(b"iTXt", b"k\0\1\0\0\0" + zlib.compress(bytes(100_000))),
    ],
    ids=["zTXt", "iTXt"],
)
@pytest.mark.usefixtures("no_decoder")
def test_countless_packed_texts_never_reach_the_decoder(text: bytes) -> None:
    """It would unpack and keep all of them: 3 MB took 3 GB."""
    with pytest.raises(ImageTooLarge, match="packed texts"):
        decode_image(png(*[text] * 9, PIXELS, END))


@pytest.mark.usefixtures("no_decoder")
def test_an_animated_png_never_reaches_the_decoder() -> None:
    with pytest.raises(UnsupportedImage, match="animated"):
        decode_image(png(chunk(b"acTL", struct.pack(">II", 2, 0)), PIXELS, END))


@pytest.mark.parametrize(
    "wrong",
    [
        {"colour": 5},
        {"bits": 3},
        {"interlaced": 2},
    ],
    ids=["colour", "bits", "interlaced"],
)
def test_a_png_of_pixels_that_there_are_not_is_a_broken_image(wrong: dict[str, int]) -> None:
    with pytest.raises(BrokenImage):
        decode_image(png(PIXELS, END, **wrong))


def test_a_png_keeps_its_texts_and_may_have_something_behind_its_end() -> None:
    texts = [
        *[chunk(b"zTXt", b"k\0\0" + zlib.compress(bytes(1000)))] * 8,
        *[chunk(b"iTXt", b"k\0\0\0\0\0" + b"plain")] * 50,
        *[chunk(b"tEXt", b"k\0" + b"plain")] * 50,
    ]
    assert np.array_equal(decode_image(png(*texts, PIXELS, END, b"behind it")), PHOTO)


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (4, 5), (5, 4), (9, 17), (64, 48)])
@pytest.mark.parametrize("interlaced", [0, 1])
@pytest.mark.parametrize(
    ("bits", "colour", "channels"),
    [(1, 0, 1), (2, 0, 1), (4, 0, 1), (8, 0, 1), (16, 0, 1), (8, 2, 3), (16, 2, 3), (1, 3, 1), (16, 6, 4)],
)
def test_each_kind_of_png_decodes_as_opencv_alone_decodes_it(
    size: tuple[int, int], interlaced: int, bits: int, colour: int, channels: int
) -> None:
    width, height = size
    passes = _PNG_PASSES if interlaced else [(0, 0, 1, 1)]
    rows, rng = [], np.random.default_rng(3)
    for column, row, wide, high in passes:
        columns = len(range(column, width, wide))
        row_bytes = (columns * bits * channels + 7) // 8
        rows += [b"\0" + rng.bytes(row_bytes) for _ in range(row, height, high) if columns]
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, interlaced))
    before = SIGNATURE + header + chunk(b"PLTE", bytes(range(6)))

    def of(pixels: bytes) -> bytes:
        return before + chunk(b"IDAT", zlib.compress(pixels)) + END

    data = of(b"".join(rows))
    assert np.array_equal(decode_image(data), cv2.imdecode(np.frombuffer(data, np.uint8), 1))
    with pytest.raises(BrokenImage, match="more bytes of pixels"):
        decode_image(of(b"".join(rows) + b"x"))
