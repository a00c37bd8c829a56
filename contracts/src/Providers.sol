// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IAccessControl} from "@openzeppelin/contracts/access/IAccessControl.sol";
import {Math} from "@openzeppelin/contracts/utils/math/Math.sol";
import {IOrganization} from "./interfaces/IOrganization.sol";
import {
    Agreement,
    Cover,
    Ended,
    IProviders,
    Namers,
    Outcome,
    Profile,
    Terms
} from "./interfaces/IProviders.sol";
import {IServiceManager} from "./interfaces/IServiceManager.sol";
import {Units} from "./libraries/Units.sol";
import {ServiceId} from "./types/ServiceId.sol";
import {TaskId} from "./types/TaskId.sol";
import {MAX_MINOR, MINOR_BITS} from "./types/Weight.sol";

contract Providers is IProviders {
    /// @dev One word, which each verdict writes.
    struct Provider {
        uint8 missed;
        uint8 failures;
        /// @dev How often it has fallen asleep, or had to rest, since the last accepted proof; at most MAX_NAPS.
        uint8 naps;
        /// @dev Until when it rests, or when it may wake up. Where `naps` is 0: when a provider that is not proven last gave work
        /// back or missed it; 0 if it never did.
        uint32 restsUntil;
        /// @dev What it was paid for accepted work of others (56 bits), and what it would have been paid for work that
        /// failed (56 bits), in `_unit`, as of a day (16 bits): both decay. Between them who was the last creator that day
        /// whose attempt counted (16 bits), see _signOf; 0 if there was none, or only the organization. One number, because
        /// it is written so.
        uint144 work;
        /// @dev See OWNED and the constants after it.
        uint16 flags;
        /// @dev The last byte of the first creator whose task it did. Two creators with the same byte count as one.
        uint8 firstCreator;
        /// @dev Of its first service, by which tasks know whom they have passed.
        uint32 number;
    }

    /// @dev Attempts without a proof, since the last accepted one, after which a proven provider falls asleep. Its services
    /// are then paused, each as it misses one. So a provider that is not there does not take every attempt of every task.
    uint256 private constant MAX_MISSED = 3;
    /// @dev How long a provider rests that is not proven, s. It doubles each time until a proof is accepted. A proven one
    /// that falls asleep may wake up at once the first time, and waits as long from the second time on.
    uint256 private constant COOL_DOWN = 10 minutes;
    /// @dev From this time on the wait does not grow: 21 hours.
    uint256 private constant MAX_NAPS = 8;
    /// @dev How long the bond of a provider that is not proven stays locked after it last gave work back or missed it, s.
    uint256 private constant BOND_DELAY = 24 hours;
    /// @dev Accepted attempts that prove a provider: for two creators at least, or all for the organization. Kept in two
    /// bits.
    uint16 private constant PROOFS = 3;
    /// @dev Days after which work counts half for the reputation of its provider.
    uint256 private constant HALF_LIFE = 90;
    /// @dev Grades of reputation by which waiting services are compared. More would mean more lines, and each new
    /// one costs the first service in it two words.
    uint256 private constant GRADES = 8;
    /// @dev IOrganization's, whose services are its operators'.
    bytes32 private constant OPERATOR_ROLE = keccak256("OPERATOR_ROLE");
    /// @dev A newcomer counts as if it had done work for so many tokens well, and as much badly.
    uint256 private constant PRIOR = 100;
    /// @dev Of Provider.flags: it is somebody's device (see _owners).
    uint16 private constant OWNED = 1;
    /// @dev Somebody's device was its own.
    uint16 private constant OWNS = 1 << 1;
    /// @dev A task has named it and waited for it: each of its services has to look at its queue.
    uint16 private constant HIRED = 1 << 2;
    /// @dev Another address is paid (see _payouts). Here, because this word is read before each payment.
    uint16 private constant PAID_ELSEWHERE = 1 << 3;
    /// @dev The organization vouches for it.
    uint16 private constant VOUCHED = 1 << 4;
    /// @dev Its accepted work has proven it.
    uint16 private constant EARNED = 1 << 5;
    /// @dev It worked for another creator than the first.
    uint16 private constant SECOND_CREATOR = 1 << 6;
    /// @dev Its accepted attempts for others, 0 .. 3, in two bits, and those for the organization in the next two.
    uint16 private constant ACCEPTED = 1 << 7;
    uint16 private constant FOR_ORGANIZATION = 1 << 9;

    /// @dev More than 72 million tokens of work are not told apart.
    uint256 private constant MAX_WORK = type(uint56).max;
    /// @dev The bits of a reputation that are its grade.
    uint64 private constant GRADE = MAX_MINOR - (uint64((1 << MINOR_BITS) / GRADES) - 1);
    /// @dev The part of work that a day leaves: 2 ** (-1 / HALF_LIFE), times 2 ** 64.
    uint256 private constant DAILY = 18305219661902323056;

    IServiceManager private immutable _services = IServiceManager(msg.sender);
    address private immutable _organization;
    uint256 private immutable _unit;
    /// @dev PRIOR in `_unit`.
    uint256 private immutable _prior;

    mapping(address provider => Provider) private _providers;
    mapping(address device => address) private _owners;
    /// @dev Only where PAID_ELSEWHERE is set.
    mapping(address provider => address) private _payouts;
    mapping(ServiceId serviceId => Agreement) private _agreements;

    modifier onlyServiceManager() {
        _requireServiceManager();
        _;
    }

    constructor(IOrganization organization) {
        _organization = address(organization);
        uint256 perToken;
        (_unit, perToken) = Units.unitOf(organization.token());
        _prior = PRIOR * perToken;
    }

    /// @inheritdoc IProviders
    function enter(address provider, ServiceId serviceId, Terms calldata terms)
        external
        onlyServiceManager
        returns (uint32, bool, bool)
    {
        _requireAwake(provider);
        Provider storage p = _providers[provider];
        if (p.number == 0) {
            (p.number, p.work) = (serviceId.pack(), _work(0, 0, 0));
            if (provider == _organization) _setFlag(p, VOUCHED, true);
        }
        if (terms.bond != 0 || terms.maxFailures != 0) {
            _agreements[serviceId] =
                Agreement(terms.bond, terms.penalty, terms.maxFailures, 0, Namers.Proven, 0);
            emit TermsAgreed(serviceId, terms.bond, terms.penalty, terms.maxFailures);
        }
        return (p.number, _isProven(p.flags), p.flags & HIRED != 0);
    }

    /// @inheritdoc IProviders
    function note(Ended calldata e) external onlyServiceManager returns (Profile memory profile) {
        _note(e, profile);
        bool aside = e.outcome == Outcome.Pending;
        if (!aside && !_costs(e.outcome, profile.proven)) return profile;
        Agreement storage a = _agreements[e.serviceId];
        uint96 penalty = a.penalty < a.bond ? a.penalty : a.bond;
        profile.penalty = penalty;
        if (penalty != 0) {
            a.bond -= penalty;
            if (aside) ++a.open;
            if (aside) emit PenaltySetAside(e.serviceId, e.taskId, penalty);
            else emit BondPenalized(e.serviceId, e.taskId, penalty);
        }
        profile.cover = _cover(a, aside ? 0 : _providers[e.provider].failures);
    }

    /// @inheritdoc IProviders
    function conclude(Ended calldata e, uint96 penalty, bool retired)
        external
        onlyServiceManager
        returns (Profile memory profile)
    {
        _note(e, profile);
        Agreement storage a = _agreements[e.serviceId];
        if (penalty != 0) --a.open;
        bool costs = _costs(e.outcome, profile.proven);
        if (penalty != 0 && costs) {
            profile.penalty = penalty;
            emit BondPenalized(e.serviceId, e.taskId, penalty);
        } else if (penalty != 0 && retired && a.bond == 0) {
            profile.bond = penalty;
            emit BondReturned(e.serviceId, e.provider, penalty);
        } else if (penalty != 0) {
            a.bond += penalty;
            emit PenaltyReturned(e.serviceId, e.taskId, penalty);
        }
        profile.cover = _cover(a, costs ? _providers[e.provider].failures : 0);
    }

    /// @inheritdoc IProviders
    function takeBond(ServiceId serviceId, address provider)
        external
        onlyServiceManager
        returns (uint96 bond, uint256 until)
    {
        bond = _agreements[serviceId].bond;
        if (bond == 0) return (0, 0);
        until = lockedUntil(provider);
        if (block.timestamp < until) return (bond, until);
        _agreements[serviceId].bond = 0;
        emit BondReturned(serviceId, provider, bond);
        return (bond, 0);
    }

    /// @inheritdoc IProviders
    function setNamers(ServiceId serviceId, Namers namers, uint8 maxVoids) external {
        address provider = _services.providerOf(serviceId);
        bool itsOwn = msg.sender == provider
            || (provider == _organization && IAccessControl(provider).hasRole(OPERATOR_ROLE, msg.sender));
        if (!itsOwn) revert IServiceManager.NotProvider(serviceId, msg.sender, provider);
        (_agreements[serviceId].namers, _agreements[serviceId].maxVoids) = (namers, maxVoids);
        emit NamersChanged(serviceId, namers, maxVoids);
    }

    /// @inheritdoc IProviders
    function setHired(address provider) external onlyServiceManager {
        _setFlag(_providers[provider], HIRED, true);
    }

    /// @inheritdoc IProviders
    function wake(address provider) external onlyServiceManager {
        Provider storage p = _providers[provider];
        if (p.restsUntil == 0) revert ProviderIsAwake(provider);
        if (block.timestamp < p.restsUntil) revert ProviderIsAsleep(provider, p.restsUntil);
        // That of others says how long their bonds are locked.
        if (_isProven(p.flags)) (p.missed, p.restsUntil) = (0, 0);
        emit ProviderWokeUp(provider);
    }

    /// @inheritdoc IProviders
    function forgive(ServiceId serviceId, address provider) external onlyServiceManager {
        _requireCovered(serviceId);
        _providers[provider].failures = 0;
    }

    /// @inheritdoc IProviders
    function vouch(address provider, bool vouched) external onlyServiceManager returns (bool changed) {
        Provider storage p = _providers[provider];
        bool before = _isProven(p.flags);
        // The organization needs no proof.
        _setFlag(p, VOUCHED, vouched || provider == _organization);
        emit ProviderVouched(provider, vouched);
        changed = before != _isProven(p.flags);
        if (changed) (p.missed, p.naps, p.restsUntil) = (0, 0, 0);
    }

    /// @inheritdoc IProviders
    function setPayout(address provider, address payout) external {
        Provider storage p = _providers[provider];
        address current = _payoutOf(provider, p.flags);
        if (msg.sender != current) revert NotPayout(provider, msg.sender, current);
        if (payout == address(0)) revert NoPayout(provider);
        _payouts[provider] = payout;
        _setFlag(p, PAID_ELSEWHERE, payout != provider);
        emit PayoutChanged(provider, payout);
    }

    /// @inheritdoc IProviders
    function recordOwner(address device, address owner) external {
        if (msg.sender != _organization) revert NotOrganization(msg.sender);
        _owners[device] = owner;
        _setFlag(_providers[device], OWNED, true);
        _setFlag(_providers[owner], OWNS, true);
    }

    /// @inheritdoc IProviders
    function isProven(address account) public view returns (bool) {
        return account == _organization || _isProven(_providers[account].flags);
    }

    /// @inheritdoc IProviders
    function rests(address provider) public view returns (bool) {
        Provider storage p = _providers[provider];
        return block.timestamp < p.restsUntil && !_isProven(p.flags);
    }

    /// @inheritdoc IProviders
    function asleepUntil(address provider) public view returns (uint256) {
        Provider storage p = _providers[provider];
        return _isProven(p.flags) || block.timestamp < p.restsUntil ? p.restsUntil : 0;
    }

    /// @inheritdoc IProviders
    function requireReady(ServiceId serviceId, address provider) external view {
        _requireAwake(provider);
        _requireCovered(serviceId);
    }

    /// @inheritdoc IProviders
    function requireNamable(ServiceId serviceId, address creator, uint256 voids) external view {
        (Namers namers, uint8 maxVoids) = (_agreements[serviceId].namers, _agreements[serviceId].maxVoids);
        bool may = namers == Namers.Anybody || (namers == Namers.Proven && isProven(creator));
        bool fewVoids = maxVoids == 0 || voids <= maxVoids;
        if ((may && fewVoids) || areRelated(creator, _services.providerOf(serviceId))) return;
        if (!may) revert NotNamable(serviceId, creator, namers);
        revert TooManyVoids(serviceId, creator, voids, maxVoids);
    }

    /// @inheritdoc IProviders
    function agreementOf(ServiceId serviceId) external view returns (Agreement memory) {
        return _agreements[serviceId];
    }

    /// @inheritdoc IProviders
    function lockedUntil(address provider) public view returns (uint256) {
        Provider storage p = _providers[provider];
        if (p.restsUntil == 0 || _isProven(p.flags)) return 0;
        return _restedFrom(p) + BOND_DELAY;
    }

    /// @inheritdoc IProviders
    function recordOf(address provider)
        external
        view
        returns (uint64 reputation, uint64 grade, uint8 failures)
    {
        Provider storage p = _providers[provider];
        reputation = _reputation(p);
        return (reputation, reputation & GRADE, p.failures);
    }

    /// @inheritdoc IProviders
    function payoutOf(address account) external view returns (address) {
        return _payoutOf(account, _providers[account].flags);
    }

    /// @inheritdoc IProviders
    function areRelated(address account, address other) public view returns (bool) {
        return account == other || (_hasDevices(_providers[other].flags) && _areOwners(account, other));
    }

    /// @inheritdoc IProviders
    function partyAmong(address[] calldata accounts, address provider, address creator)
        external
        view
        returns (address)
    {
        (bool ofCreator, bool ofProvider) =
            (_hasDevices(_providers[creator].flags), _hasDevices(_providers[provider].flags));
        for (uint256 i = 0; i < accounts.length; ++i) {
            address account = accounts[i];
            if (account == creator || (ofCreator && _areOwners(account, creator))) return account;
            if (account == provider || (ofProvider && _areOwners(account, provider))) return account;
        }
        return address(0);
    }

    /// @dev An attempt goes into its provider's record.
    function _note(Ended calldata e, Profile memory profile) private {
        Provider storage p = _providers[e.provider];
        uint16 flags = p.flags;
        bool before = _isProven(flags);
        bool missed = e.outcome == Outcome.Missed || e.outcome == Outcome.Expired;
        profile.payout = _payoutOf(e.provider, flags);
        if (e.outcome <= Outcome.AbandonedLate) {
            flags = _judge(e, p, flags, profile.payout);
        }
        profile.proven = _isProven(flags);
        profile.earned = profile.proven && !before;
        if (profile.proven) {
            if (missed && e.provider != _organization) _miss(e.provider, p);
            profile.asleep = p.restsUntil != 0;
        } else {
            bool gaveBack = e.outcome == Outcome.Abandoned || e.outcome == Outcome.AbandonedLate;
            if (missed || gaveBack || e.outcome == Outcome.Void) _rest(e.provider, p);
            profile.rests = block.timestamp < p.restsUntil;
        }
        profile.grade = _reputation(p) & GRADE;
    }

    /// @dev A judged attempt goes into the provider's record. Returns its flags, which are `flags` before.
    function _judge(Ended calldata e, Provider storage p, uint16 flags, address payout)
        private
        returns (uint16)
    {
        bool own = _isOwn(e.provider, flags, payout, e.creator);
        bool accepted = e.outcome == Outcome.Completed;
        uint256 value = e.value / _unit;
        if (value != 0 && !own) _rate(p, e.creator, accepted, value);
        if (!accepted) {
            if (p.failures < type(uint8).max) ++p.failures;
        } else if (!own) {
            if (p.missed | p.failures | p.naps != 0) _forgive(e.provider, p);
            if (!_isProven(flags) && value != 0) return _prove(e.provider, p, flags, e.creator);
        }
        return flags;
    }

    /// @dev Work for others was accepted, and may have proven its provider.
    function _prove(address provider, Provider storage p, uint16 flags, address creator)
        private
        returns (uint16)
    {
        uint8 sign = uint8(uint160(creator));
        if (flags / ACCEPTED & PROOFS == 0) p.firstCreator = sign;
        else if (p.firstCreator != sign) flags |= SECOND_CREATOR;
        if (flags / ACCEPTED & PROOFS != PROOFS) flags += ACCEPTED;
        if (creator == _organization && flags / FOR_ORGANIZATION & PROOFS != PROOFS) {
            flags += FOR_ORGANIZATION;
        }
        bool all = flags / ACCEPTED & PROOFS == PROOFS;
        bool earned = (all && flags & SECOND_CREATOR != 0) || flags / FOR_ORGANIZATION & PROOFS == PROOFS;
        if (earned) (flags, p.restsUntil) = (flags | EARNED, 0);
        p.flags = flags;
        if (earned) emit ProviderProven(provider);
        return flags;
    }

    /// @dev A provider is known for work for others, by its value. Nobody pays oneself, or nothing, for a name. Of attempts for
    /// one creator in a row only the first of a day counts, however it ended: no creator makes or ruins a name alone in an
    /// afternoon. Those for the organization all count: what it posts is paid by its treasury, and its operators have budgets.
    function _rate(Provider storage p, address creator, bool accepted, uint256 value) private {
        uint256 work = p.work;
        uint256 last = uint16(work) == block.timestamp / 1 days ? uint16(work >> 16) : 0;
        if (creator != _organization) {
            uint256 sign = _signOf(creator);
            if (sign == last) return;
            last = sign;
        }
        (uint256 done, uint256 failed) = _record(p);
        if (accepted) done = Math.min(done + value, MAX_WORK);
        else failed = Math.min(failed + value, MAX_WORK);
        p.work = _work(done, failed, last);
    }

    /// @dev By what a creator is remembered, never 0. Two with the same sign, one in 65,535, count as one.
    function _signOf(address creator) private pure returns (uint256) {
        return uint160(creator) % type(uint16).max + 1;
    }

    /// @dev A proof was accepted, of work for others.
    function _forgive(address provider, Provider storage p) private {
        if (p.restsUntil != 0 && p.naps != 0) emit ProviderWokeUp(provider);
        // One task that a friend pays does not free the bond of a provider that gave another one back before.
        p.restsUntil = _isProven(p.flags) || p.restsUntil == 0 ? 0 : _restedFrom(p);
        (p.missed, p.failures, p.naps) = (0, 0, 0);
    }

    /// @dev When a provider that is not proven last gave work back or missed it, of one that did.
    function _restedFrom(Provider storage p) private view returns (uint32) {
        return p.naps == 0 ? p.restsUntil : p.restsUntil - uint32(COOL_DOWN << (p.naps - 1));
    }

    /// @dev A proven provider let an attempt pass without a proof, whichever of its services made it.
    function _miss(address provider, Provider storage p) private {
        if (p.missed < MAX_MISSED) ++p.missed;
        if (p.missed < MAX_MISSED || p.restsUntil != 0) return;
        p.restsUntil = uint32(block.timestamp + (p.naps == 0 ? 0 : COOL_DOWN << (p.naps - 1)));
        if (p.naps < MAX_NAPS) ++p.naps;
        emit ProviderFellAsleep(provider, p.restsUntil);
    }

    /// @dev A provider that is not proven gets no task for a while, which is twice as long each time.
    function _rest(address provider, Provider storage p) private {
        if (p.naps < MAX_NAPS) ++p.naps;
        p.restsUntil = uint32(block.timestamp + (COOL_DOWN << (p.naps - 1)));
        emit ProviderRests(provider, p.restsUntil);
    }

    /// @dev The provider takes no part before its rest is over, or it has woken up.
    function _requireAwake(address provider) private view {
        uint256 until = asleepUntil(provider);
        if (until != 0) revert ProviderIsAsleep(provider, until);
    }

    /// @dev The bond covers another penalty.
    function _requireCovered(ServiceId serviceId) private view {
        Agreement storage a = _agreements[serviceId];
        if (a.bond < a.penalty) revert BondExhausted(serviceId, a.bond, a.penalty);
    }

    /// @dev What is left of the bond, and failures in a row, mean for the service.
    function _cover(Agreement storage a, uint256 failures) private view returns (Cover) {
        if (a.maxFailures != 0 && failures >= a.maxFailures) return Cover.Failing;
        if (a.bond >= a.penalty) return Cover.Enough;
        return a.open == 0 ? Cover.Exhausted : Cover.Short;
    }

    /// @dev Whether an attempt that ended so costs the penalty.
    function _costs(Outcome outcome, bool proven) private pure returns (bool) {
        bool failed = outcome != Outcome.Completed && outcome <= Outcome.AbandonedLate;
        return failed || (outcome == Outcome.GivenUp && !proven);
    }

    function _setFlag(Provider storage p, uint16 flag, bool set) private {
        p.flags = set ? p.flags | flag : p.flags & ~flag;
    }

    function _isProven(uint16 flags) private pure returns (bool) {
        return flags & (VOUCHED | EARNED) != 0;
    }

    /// @dev The address that is paid for the provider's work. `flags` are its own.
    function _payoutOf(address provider, uint16 flags) private view returns (address) {
        return flags & PAID_ELSEWHERE != 0 ? _payouts[provider] : provider;
    }

    /// @dev Whether the creator of a task is its provider, or one owns the other, or somebody owns both, or what the
    /// provider earns goes back to whoever pays.
    function _isOwn(address provider, uint16 flags, address payout, address creator)
        private
        view
        returns (bool)
    {
        // Whoever has nothing to do with devices has nothing to do with the creator's owner either.
        if (!_hasDevices(flags) && payout == provider) return creator == provider;
        address payer = _ownerOf(creator);
        return payer == _ownerOf(provider) || payer == payout;
    }

    /// @dev Whether one owns the other, or somebody owns both.
    function _areOwners(address account, address other) private view returns (bool) {
        (address owner, address othersOwner) = (_ownerOf(account), _ownerOf(other));
        return owner == othersOwner || owner == other || account == othersOwner;
    }

    /// @dev The owner of a device; any other account itself.
    function _ownerOf(address account) private view returns (address owner) {
        owner = _owners[account];
        if (owner == address(0)) owner = account;
    }

    /// @dev Whether it is a device, or has had one: nobody else is related to another account.
    function _hasDevices(uint16 flags) private pure returns (bool) {
        return flags & (OWNED | OWNS) != 0;
    }

    /// @dev (done + _prior) / (done + failed + 2 _prior) in 64ths, the rule of succession (Laplace): 0 .. 63.
    function _reputation(Provider storage p) private view returns (uint64) {
        (uint256 done, uint256 failed) = _record(p);
        // Both have 56 bits, and what a newcomer counts for has 64 at most.
        unchecked {
            done += _prior;
            return uint64((done << MINOR_BITS) / (done + failed + _prior));
        }
    }

    /// @dev The rest today of what the provider has done and failed. By whole days, so that it does not matter
    /// how often it is computed.
    function _record(Provider storage p) private view returns (uint256 done, uint256 failed) {
        uint256 work = p.work;
        (done, failed) = (work >> 88, (work >> 32) & MAX_WORK);
        uint256 elapsed = block.timestamp / 1 days - uint16(work);
        if (elapsed == 0) return (done, failed);
        (done, failed) = (done >> (elapsed / HALF_LIFE), failed >> (elapsed / HALF_LIFE));
        uint256 factor = DAILY;
        // slither-disable-next-line weak-prng
        for (elapsed %= HALF_LIFE; elapsed != 0; elapsed >>= 1) {
            if (elapsed & 1 == 1) (done, failed) = (done * factor >> 64, failed * factor >> 64);
            factor = factor * factor >> 64;
        }
    }

    function _work(uint256 done, uint256 failed, uint256 last) private view returns (uint144) {
        return uint144(done << 88 | failed << 32 | last << 16 | block.timestamp / 1 days);
    }

    function _requireServiceManager() private view {
        if (msg.sender != address(_services)) revert NotServiceManager(msg.sender);
    }
}
