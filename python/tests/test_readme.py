"""The lines of the README."""

import re
import shutil

from conftest import DATA

README = DATA.parents[1] / "README.md"
SOCKETS = "\n".join(f"[[sphere]]\nid = {k}\nx_mm = {x}\ny_mm = 0\nz_mm = 0\nsigma_mm = 0.005" for k, x in [(1, 0), (2, 50)])


# Fails if the README's lines do not calibrate the real iiwa 14, print the line that the README shows, and draw it.
def test_the_readme_calibrates_a_real_arm(tmp_path, monkeypatch, capsys):
    text = README.read_text(encoding="utf-8")
    lines = re.search(r"```python\n(.*?)```", text, re.DOTALL).group(1)
    answer = re.search(r"^iiwa14: .*$", text, re.MULTILINE).group(0)
    for name in ["mukca_iiwa14.csv", "iiwa14.urdf"]:
        shutil.copy(DATA / name, tmp_path)
    (tmp_path / "sockets.toml").write_text(SOCKETS, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    exec(compile(lines, "README.md", "exec"), {})
    assert capsys.readouterr().out.strip() == answer
    assert (tmp_path / "iiwa14.png").stat().st_size > 10_000
    assert (tmp_path / "result" / "report.html").exists()
