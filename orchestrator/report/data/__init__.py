"""The data of report and live page, whose field names are the keys of their JSON."""
