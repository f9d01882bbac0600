"""The bus between peers over Zenoh: sessions, the mailbox, and the participants of a process."""
