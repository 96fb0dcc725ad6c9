"""Write the pages of the environments: `python -m flexarm_env.pages --out docs/envs`."""

import argparse
from pathlib import Path

from dynamics.description.data_file import user_path
from flexarm_env.pages.environments import common_page, file_name, page
from flexarm_env.registration import IDS


def main() -> None:
    """Write all pages into a folder."""
    parser = argparse.ArgumentParser(description="Write the pages of the environments.")
    parser.add_argument("--out", type=user_path, default=Path("docs/envs"))
    folder = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    for env_id in IDS:
        (folder / file_name(env_id)).write_text(page(env_id), encoding="utf-8")
    (folder / "README.md").write_text(common_page(), encoding="utf-8")


if __name__ == "__main__":
    main()
