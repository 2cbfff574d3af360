// The live page: the token is in the fragment of the address.
import { start } from "./main.js";

start({ token: new URLSearchParams(location.hash.slice(1)).get("token") ?? "" });
