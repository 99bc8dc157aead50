#!/usr/bin/perl
# Perl: IO::Socket and IO::Select, Time::HiRes; two agents send numbered datagrams.
use strict; use warnings; use IO::Select; use IO::Socket::INET; use Time::HiRes qw(sleep time);
$| = 1; my $me = shift; my $other = 3 - $me; my $start = time;
my $s = IO::Socket::INET->new(Proto => 'udp', LocalPort => 5080) or die $!;
my $to = pack_sockaddr_in(5080, inet_aton("10.0.0.$other")); my $select = IO::Select->new($s); my ($due, $k) = ($start + 0.95, 0);
while (time < $start + 5) {
    if (time >= $due && $k < 4) { $s->send("$k of $me", 0, $to); $k++; $due += 1; }
    if ($select->can_read(0.1)) { $s->recv(my $data, 100); printf "%.1f heard %s from %s\n", time - $start, $data, $s->peerhost; }
}
print "chance ", rand(), "\ndone\n";
