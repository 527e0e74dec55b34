"""Write the diagrams to docs/images, and the table of metrics into its page; tests keep them current."""

from perfbound.orchestrator.report.web.metric_list import metrics_table
from tests.architecture.diagrams import FOLDER, texts

for name, text in texts().items():
    (FOLDER / name).write_text(text)

PAGE, BEGIN, END = FOLDER.parent / "campaign.md", "<!-- metrics -->\n", "<!-- end of metrics -->"
head, _, rest = PAGE.read_text().partition(BEGIN)
PAGE.write_text(f"{head}{BEGIN}{metrics_table()}\n{END}{rest.partition(END)[2]}")
