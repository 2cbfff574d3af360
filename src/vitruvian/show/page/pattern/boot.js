// The page of the pattern editor: the token is in the fragment of the address.
import { start } from "./main.js";

start(new URLSearchParams(location.hash.slice(1)).get("token") ?? "");
