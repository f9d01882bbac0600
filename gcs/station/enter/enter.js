// Sends the token once: it stands behind the # of the address, which browsers do not send.
const state = document.querySelector("#state");
const field = document.querySelector("#token");

async function enter(token) {
  const answer = await fetch("/enter", { method: "POST", body: token }).catch(() => null);
  if (answer?.ok) {
    location.replace("/");
    return;
  }
  state.textContent = answer ? "Wrong token. Use the address that cordon station printed last."
    : "The station does not answer. Check that it runs.";
}

document.querySelector("form").addEventListener("submit", (event) => {
  event.preventDefault();
  enter(field.value.trim());
});

const token = decodeURIComponent(location.hash.slice(1));
if (token) {
  history.replaceState(null, "", "/");
  enter(token);
}
