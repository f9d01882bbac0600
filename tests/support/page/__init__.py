"""What tests and experiments of the operator's page share: stations, what they show, a browser, and its meter."""
