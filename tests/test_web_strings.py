"""The words of the page, in its languages."""

from __future__ import annotations

import json
import re
import subprocess
from html.parser import HTMLParser

import pytest
from web_pages import NODE, ROOT, Job, in_browser, open_pages, small_page

PAGE = ROOT / "viewer" / "web" / "page"

#: Scripts that list words.
WORDS = ("strings", "inspect_words")

#: Texts that are the same in every language, or are only there without the page's script.
SAME = re.compile(r"[-\W\d]*|[A-Z]|Home|W A S D Q E|N, P|1 2 3 4|Loading\. If this stays.*")

LISTED = """
import * as all from STRINGS;
import { INSPECTED } from INSPECTION;
const shared = Object.keys(INSPECTED).filter((word) => word in all.WORDS);
if (shared.length) throw new Error(`twice: ${shared}`);
Object.assign(all.WORDS, INSPECTED);
const asked = ASKED.map(([hash, preferred]) => all.languageOf(hash, preferred));
console.log(JSON.stringify([all.LANGUAGES, all.WORDS, asked]));
"""


def listed(asked: list) -> list:
    """Languages, words, and the languages for some addresses and preferences."""
    script = LISTED.replace("STRINGS", json.dumps((PAGE / "strings.js").as_uri()))
    script = script.replace("INSPECTION", json.dumps((PAGE / "inspect_words.js").as_uri()))
    script = script.replace("ASKED", json.dumps(asked))
    done = subprocess.run(
        [str(NODE), "--input-type=module", "-e", script],
        capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    return json.loads(done.stdout)


class Texts(HTMLParser):
    """Texts of elements, and their names."""

    def __init__(self) -> None:
        super().__init__()
        self.found: set[str] = set()

    def handle_starttag(self, tag: str, attributes: list) -> None:
        self.found.update(value for name, value in attributes if name == "aria-label")

    def handle_data(self, data: str) -> None:
        if "<!--" not in data:  # a comment in the title, which is text from Python 3.14 on
            self.found.add(data.strip())


@pytest.mark.skipif(NODE is None, reason="needs Node")
def test_every_text_is_in_every_language_and_none_is_left_over():
    languages, words, _ = listed([])
    texts = Texts()
    texts.feed((PAGE / "page.html").read_text())
    scripts = {path: path.read_text() for path in PAGE.glob("*.js") if path.stem not in WORDS}
    script = "\n".join(scripts.values())
    said = re.findall(r"\bsay\(\s*'((?:[^'\\]|\\.)*)'", script)
    nouns = re.findall(r"\bcounted\([^']*'(\w+)'", script)
    counts = {text for noun in nouns for text in (f"1 {noun}", f"{{}} {noun}s")}
    asked = {text for text in texts.found if not SAME.fullmatch(text)} | set(said) | counts
    assert len(asked) > 50
    assert asked <= set(words)
    spare = [word for word in set(words) - asked if not re.search(rf"\b{word}\b", script)]
    assert spare == []
    for word, others in words.items():
        assert len(others) == len(languages) - 1, word
        assert all(others), word
        assert {other.count("{}") for other in others} == {word.count("{}")}, word


@pytest.mark.skipif(NODE is None, reason="needs Node")
def test_the_address_or_else_the_browser_chooses_the_language():
    asked = {
        ("", "en-GB"): "en",
        ("", "pt-BR", "fr-CA", "de"): "fr",
        ("#view=1&lang=ja", "de"): "ja",
        ("#lang=toString", "zh-Hant-TW"): "zh",
        ("#lang=DE",): "de",
        ("",): "en",
    }
    languages, _, found = listed([(hash_, preferred) for hash_, *preferred in asked])
    assert list(languages) == ["en", "de", "fr", "zh", "ja"]
    assert found == list(asked.values())


@in_browser
def test_a_page_speaks_the_language_of_its_reader(tmp_path):
    url = small_page(tmp_path, "Show.ply")
    told = (
        "value",
        """[document.documentElement.lang, save.textContent,
        ...document.querySelector('#scenes li').childNodes].map((one) => one.textContent ?? one)""",
    )
    german = Job(url, [("drawn",), told], locale="de-CH", panel=True)
    german.steps.append(("choose", "#language", "fr"))
    german.steps.append(("until", "document.documentElement.lang === 'fr'"))
    german.steps += [("drawn",), told, ("value", "location.hash")]
    german.steps += [("until", "document.querySelector('summary').textContent === 'Scène'")]
    opened = open_pages(german, Job(url + "#lang=zh", [("drawn",), told]))
    for one in opened:
        assert (one.state, one.errors) == ("ready", [])
    assert opened[0].values[1][:3] == ["de", "Bild speichern", "Show.ply"]
    assert opened[0].values[1][3].startswith("500 Gaussians, SH-Grad 0, 7,00 kB, ")
    assert opened[0].values[5][:3] == ["fr", "Enregistrer l’image", "Show.ply"]
    assert opened[0].values[6] == "#view=0&lang=fr"
    assert opened[1].values[1][:2] == ["zh", "保存图片"]


#: The panel's colours: background and text.
COLOURS = """(() => {
    const { backgroundColor, color } = getComputedStyle(document.getElementById('panel'));
    return [backgroundColor, color].map((each) => /\\d+/.exec(each)[0]);
})()"""


@in_browser
def test_the_panel_is_dark_or_light_as_the_system_asks_or_as_chosen(tmp_path):
    """Here, the system asks for light."""
    url = small_page(tmp_path)
    light = Job(url, [("drawn",), ("value", COLOURS), ("choose", "#theme", "dark")], panel=True)
    light.steps += [("value", COLOURS), ("until", "location.hash.endsWith('&theme=dark')")]
    dark = Job(url + "#theme=dark", [("drawn",), ("value", COLOURS)])
    other = Job(url + "#theme=red", [("drawn",), ("value", COLOURS)])
    light, dark, other = open_pages(light, dark, other)
    assert light.errors == []
    assert (light.values[1], light.values[3]) == (["255", "17"], ["24", "238"])
    assert dark.values[1] == ["24", "238"]
    assert other.values[1] == ["255", "17"]
