"""The orchestrator's end of the Zenoh link: sessions, the inbox, the sender, routers."""
