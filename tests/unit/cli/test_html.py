"""What others wrote stands on a page as they wrote it, and steers nothing."""

from rodeo_cli.html import document, table

HOSTILE = "<script>\N{RIGHT-TO-LEFT OVERRIDE}gnirts\x07"


def test_a_word_of_others_is_no_markup_and_hides_nothing() -> None:
    page = document(HOSTILE, [table([[HOSTILE, "1"]], [HOSTILE, "count"], 1)])
    assert page.count("&lt;script&gt;\\u202egnirts\\u0007") == 3
    assert "<script" not in page
    assert page.replace("\n", "").isprintable()
