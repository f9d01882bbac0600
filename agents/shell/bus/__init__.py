"""The bus between peers over Zenoh: sessions, what arrives, and what the participants of a process receive of it."""
