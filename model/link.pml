/* The link of docs/protocol.md, channel from host to board: sequence, window, session epoch, stop generation.
 *
 * The line loses, doubles and delays; stops travel in a class of their own and overtake everything; timeouts come whenever they like;
 * the board restarts, stops by itself, and is stopped. Checked: a message that the board executes is the next one of those that the host sent in
 * the board's present session and generation: none lost, doubled, reordered, or left over from before a restart or a stop.
 *
 * "era" is a ghost: the board raises it at every session, restart and stop, tells the host in its answers, and never looks at it except in
 * the assertion. -D options seed bugs: NO_EPOCH, NO_GENERATION, W=4 with S=4 (a window as large as the sequence space).
 */

#ifndef W
#define W 3 /* window */
#endif
#ifndef S
#define S 4 /* sequence numbers */
#endif
#ifndef N
#define N 5 /* messages that the host may send in one era: the sequence wraps */
#endif
#ifndef RESTARTS
#define RESTARTS 1
#endif
#ifndef STOPS
#define STOPS 1
#endif
#ifndef OWN_STOPS
#define OWN_STOPS 1
#endif
#define EPOCHS 8
#define GENERATIONS 8
#define AHEAD(a, b) ((a + GENERATIONS - b) % GENERATIONS)

mtype = { DATA, HELLO };
mtype = { ACK, IDENTIFY, REPLY };

chan down = [2] of { mtype, byte, byte, byte, byte, byte }; /* kind, sequence, epoch, generation, message, era */
chan stops = [1] of { byte, byte };                         /* epoch, generation asked for */
chan up = [2] of { mtype, byte, byte, byte, bool, byte };   /* kind, ack or request, epoch, generation, open, era */

active proctype Host() {
	byte epoch = 255, old_epoch = 254;
	byte generation, asked, era;
	byte base, cursor, next; /* oldest unacknowledged, next to put on the line, next new message of this era */
	byte stops_left = STOPS;
	bool open, stopping;
	mtype kind;
	byte number, e, g, count, ghost;
	bool o;

	do
	:: open && !stopping && base == N -> skip /* all done; any other standstill is a deadlock that spin reports */
	:: atomic { !open && nfull(down) -> down!HELLO(0, 0, 0, 0, 0) }
	:: atomic { /* a new message */
		open && !stopping && cursor == next && next < N && next - base < W && nfull(down) ->
		down!DATA(next % S, epoch, generation, next, era);
		next++;
		cursor = next
	   }
	:: atomic { /* again */
		open && !stopping && cursor < next && nfull(down) ->
		down!DATA(cursor % S, epoch, generation, cursor, era);
		cursor++
	   }
	:: d_step { open && base < cursor -> cursor = base } /* timeout, early or not */
	:: d_step {
		open && !stopping && stops_left > 0 ->
		stops_left--;
		stopping = true;
		asked = (generation + 1) % GENERATIONS;
		base = 0; cursor = 0; next = 0
	   }
	:: atomic { stopping && open && nfull(stops) -> stops!epoch, asked }
	:: atomic {
		up?kind(number, e, g, o, ghost) ->
		if
		:: kind == IDENTIFY && !open ->
			if
			:: e != epoch && e != old_epoch ->
				open = true;
				old_epoch = epoch; epoch = e; generation = g; era = ghost;
				stopping = false;
				base = 0; cursor = 0; next = 0
			:: else -> skip
			fi
		:: kind != IDENTIFY && open && (e != epoch || !o) ->
			if
			:: e == old_epoch -> skip /* late, from the session before */
			:: else -> open = false; stopping = false; base = 0; cursor = 0; next = 0
			fi
		:: kind != IDENTIFY && open && e == epoch && o ->
			if
			:: AHEAD(g, generation) > 0 && AHEAD(g, generation) < GENERATIONS / 2 ->
				generation = g;
				era = ghost;
				base = 0; cursor = 0; next = 0
			:: else -> skip
			fi;
			if
			:: kind == REPLY && stopping && number == asked && g == asked ->
				stopping = false;
				generation = g; era = ghost;
				base = 0; cursor = 0; next = 0
			:: kind == REPLY && stopping && number == asked && g != asked ->
				asked = (g + 1) % GENERATIONS
			:: kind == ACK && g == generation && !stopping ->
				count = (number + S - (base % S)) % S;
				if
				:: count <= next - base ->
					base = base + count;
					if :: cursor < base -> cursor = base :: else -> skip fi
				:: else -> skip
				fi
			:: else -> skip
			fi
		:: else -> skip
		fi;
		kind = 0; number = 0; e = 0; g = 0; o = 0; count = 0; ghost = 0
	   }
	od
}

active proctype Board() {
	byte epoch, generation, executed = 255, expected, got, era = 1;
	byte restarts_left = RESTARTS, own_stops_left = OWN_STOPS;
	bool open;
	mtype kind;
	byte number, e, g, message, ghost;

end:	do
	:: atomic { /* a packet arrives, or a copy of it does and it arrives once more later */
		if
		:: down?kind(number, e, g, message, ghost)
		:: down?<kind(number, e, g, message, ghost)>
		fi;
		if
		:: kind == HELLO ->
			if
			:: !open ->
				open = true;
				epoch = (epoch + 1) % EPOCHS;
				expected = 0; got = 0; era++
			:: else -> skip
			fi;
			if :: nfull(up) -> up!IDENTIFY(0, epoch, generation, open, era) :: full(up) -> skip fi
		:: kind == DATA ->
			if
#ifndef NO_EPOCH
			:: !open || e != epoch -> skip
#endif
#ifndef NO_GENERATION
			:: g != generation -> skip
#endif
			:: else ->
				if
				:: number == expected ->
					assert(ghost == era); /* of this session, and from after the last stop */
					assert(message == got); /* the next one: none lost, none twice */
					got++;
					expected = (expected + 1) % S
				:: else -> skip
				fi
			fi;
			if :: nfull(up) -> up!ACK(expected, epoch, generation, open, era) :: full(up) -> skip fi
		fi;
		kind = 0; number = 0; e = 0; g = 0; message = 0; ghost = 0
	   }
	:: atomic { down?kind(number, e, g, message, ghost) -> kind = 0; number = 0; e = 0; g = 0; message = 0; ghost = 0 } /* lost */
	:: atomic { /* a stop arrives, perhaps twice */
		if
		:: stops?e, g
		:: stops?<e, g>
		fi;
		if
		:: open && e == epoch && AHEAD(g, generation) < GENERATIONS / 2 && !(g == generation && g == executed) ->
			generation = g; executed = g;
			expected = 0; got = 0; era++
		:: else -> skip
		fi;
		if :: nfull(up) -> up!REPLY(g, epoch, generation, open, era) :: full(up) -> skip fi;
		e = 0; g = 0
	   }
	:: atomic { stops?e, g -> e = 0; g = 0 } /* lost */
	:: d_step { /* stops by itself */
		open && own_stops_left > 0 ->
		own_stops_left--;
		generation = (generation + 1) % GENERATIONS;
		expected = 0; got = 0; era++
	   }
	:: d_step { /* restarts, with another epoch */
		restarts_left > 0 ->
		restarts_left--;
		open = false;
		epoch = (epoch + 2) % EPOCHS;
		generation = 0; executed = 255;
		expected = 0; got = 0; era++
	   }
	od
}

active proctype Line() { /* the way back loses and doubles too */
	mtype kind;
	byte number, e, g, ghost;
	bool o;

end:	do
	:: atomic { up?kind(number, e, g, o, ghost) -> kind = 0; number = 0; e = 0; g = 0; o = 0; ghost = 0 }
	:: atomic {
		nfull(up) && nempty(up) ->
		up?<kind(number, e, g, o, ghost)>;
		up!kind(number, e, g, o, ghost);
		kind = 0; number = 0; e = 0; g = 0; o = 0; ghost = 0
	   }
	od
}
