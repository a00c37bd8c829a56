// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {ServiceId} from "../types/ServiceId.sol";
import {TaskId} from "../types/TaskId.sol";

/// @notice The terms to which a service agrees when it is registered. All zero: nothing.
/// @param bond locked per service until it retires, in the token's smallest unit
/// @param penalty what a rejected or expired attempt takes from the bond, for the treasury; at most `bond`
/// @param maxFailures failures in a row that suspend the service; 0 for no limit
struct Terms {
    uint96 bond;
    uint96 penalty;
    uint8 maxFailures;
}

/// @notice How an attempt ended for the service that made it. The first four go into the provider's record. AbandonedLate: the
/// provider had agreed to it, and gave it back after the grace period. Unjudged: the task was impossible. Missed:
/// without a proof, and the provider had not agreed to it. Abandoned: the provider gave it back otherwise. Pending: a ruling
/// stands that may be replaced, so that it has ended for the service and not for its record.
enum Outcome {
    Completed,
    Rejected,
    Expired,
    AbandonedLate,
    Unjudged,
    Missed,
    Abandoned,
    Pending,
    GivenUp,
    Void
}

/// @notice Who may post a task that names the service.
enum Namers {
    Proven,
    Nobody,
    Anybody
}

/// @notice What a service may do with what is left of its bond. Short: nothing before a case ends for which a part of it is
/// set aside. Exhausted: nothing. Failing: nor may its provider's other services.
enum Cover {
    Enough,
    Short,
    Exhausted,
    Failing
}

/// @notice The terms that a service agreed to, what is left of its bond, and who may name it.
/// @param bond in the token's smallest unit
/// @param penalty what a failed attempt takes from the bond
/// @param maxFailures failures in a row of its provider that suspend it; 0 for no limit
/// @param open cases for which a penalty is set aside
/// @param namers who may post a task that names it
/// @param maxVoids creators of which more of 100 tasks that named somebody ended void may not; 0 for no such limit
struct Agreement {
    uint96 bond;
    uint96 penalty;
    uint8 maxFailures;
    uint32 open;
    Namers namers;
    uint8 maxVoids;
}

/// @notice An attempt that has ended.
/// @param creator who posted the task
/// @param value what the provider was paid, or would have been, in the token's smallest unit; at most the kind's reference price
struct Ended {
    ServiceId serviceId;
    TaskId taskId;
    address provider;
    address creator;
    Outcome outcome;
    uint256 value;
}

/// @notice What the service manager has to know of a provider.
/// @param payout who is paid for it
/// @param proven see IProviders.isProven
/// @param earned this attempt has proven it
/// @param rests it is not proven, and gets no task now
/// @param asleep it is proven, and has let too many attempts pass
/// @param grade of its reputation, by which waiting services are compared
/// @param penalty taken from the bond for the attempt, or set aside
/// @param bond to be returned with the case of a service that has retired
/// @param cover what the service may do with the rest
struct Profile {
    address payout;
    bool proven;
    bool earned;
    bool rests;
    bool asleep;
    uint64 grade;
    uint96 penalty;
    uint96 bond;
    Cover cover;
}

/// @title Providers: who owns them, who is paid for them, what became of their work, whether they are proven, and what their
/// services agreed to.
/// @notice It counts for all services of a provider together, so that a new service does not begin anew. The service manager
/// makes this contract and is the only one that changes anything here.
interface IProviders {
    /// @notice A proven provider has let too many attempts pass without a proof.
    /// @param until when it may wake up
    event ProviderFellAsleep(address indexed provider, uint256 until);
    /// @notice The provider called `wakeUp`, or a proof of it was accepted.
    event ProviderWokeUp(address indexed provider);
    /// @notice The provider is not proven, and gets no task before `until`.
    event ProviderRests(address indexed provider, uint256 until);
    /// @notice Its accepted work has proven it.
    event ProviderProven(address indexed provider);
    /// @notice The organization vouches for the provider, or does no longer.
    event ProviderVouched(address indexed provider, bool vouched);
    /// @notice From now on `payout` gets what the contracts owe `provider` for work, bonds and stakes.
    event PayoutChanged(address indexed provider, address indexed payout);

    /// @notice Where the organization has terms, with the service's registration.
    event TermsAgreed(ServiceId indexed serviceId, uint256 bond, uint256 penalty, uint8 maxFailures);
    /// @param amount what the failed attempt took from the bond, for the organization's treasury
    event BondPenalized(ServiceId indexed serviceId, TaskId indexed taskId, uint256 amount);
    /// @notice Until the case of this task ends, this part of the bond secures nothing else.
    event PenaltySetAside(ServiceId indexed serviceId, TaskId indexed taskId, uint256 amount);
    event PenaltyReturned(ServiceId indexed serviceId, TaskId indexed taskId, uint256 amount);
    /// @param provider whose payout address gets it
    event BondReturned(ServiceId indexed serviceId, address indexed provider, uint256 amount);
    event NamersChanged(ServiceId indexed serviceId, Namers namers, uint8 maxVoids);

    /// @notice The provider sleeps or rests. It may call IServiceManager.wakeUp at `until`.
    error ProviderIsAsleep(address provider, uint256 until);
    error ProviderIsAwake(address provider);
    /// @notice Only the payout address changes itself. It is the provider's own until it names another one.
    error NotPayout(address provider, address caller, address payout);
    /// @notice Somebody has to be paid: the provider's own address undoes the change.
    error NoPayout(address provider);
    /// @notice The service's bond does not cover another penalty.
    error BondExhausted(ServiceId serviceId, uint256 bond, uint256 penalty);
    /// @notice The service is not to be named by this creator.
    error NotNamable(ServiceId serviceId, address creator, Namers namers);
    /// @notice More of 100 tasks of the creator that named somebody ended void than the service allows.
    error TooManyVoids(ServiceId serviceId, address creator, uint256 voids, uint8 maxVoids);
    error NotServiceManager(address caller);
    error NotOrganization(address caller);

    /// @notice A provider offers a service. Only the service manager. Reverts with ProviderIsAsleep.
    /// @param serviceId the service, whose number is the provider's, too, if it is its first
    /// @param terms what it agrees to
    /// @return number of the provider
    /// @return proven see isProven
    /// @return hired whether a task has named it and waited for it
    function enter(address provider, ServiceId serviceId, Terms calldata terms)
        external
        returns (uint32 number, bool proven, bool hired);

    /// @notice An attempt has ended. It may cost its penalty, which is set aside if the attempt is Pending. Only the service
    /// manager.
    /// @return profile what is known of the provider then
    function note(Ended calldata ended) external returns (Profile memory profile);

    /// @notice The case of an attempt is over that was Pending. Only the service manager.
    /// @param penalty what was set aside for it
    /// @param retired whether the service has retired
    /// @return profile what is known of the provider then
    function conclude(Ended calldata ended, uint96 penalty, bool retired)
        external
        returns (Profile memory profile);

    /// @notice A service has retired: its bond is to be returned. Only the service manager.
    /// @return bond how much; 0 if it has none any more
    /// @return until when, if it is locked; else 0
    function takeBond(ServiceId serviceId, address provider) external returns (uint96 bond, uint256 until);

    /// @notice Say who may post tasks that name a service.
    /// @param serviceId a service of the caller, or of the organization whose operator calls
    /// @param namers who may
    /// @param maxVoids how many of 100 tasks of such a creator that named somebody may have ended void; 0 for any number
    function setNamers(ServiceId serviceId, Namers namers, uint8 maxVoids) external;

    /// @notice A task has named the provider and waits for it. Only the service manager.
    function setHired(address provider) external;

    /// @notice The provider takes part again. Only the service manager. Reverts with ProviderIsAwake or ProviderIsAsleep.
    function wake(address provider) external;

    /// @notice Forgive the provider its failures. Only the service manager. Reverts with BondExhausted.
    /// @param serviceId a service of the provider, whose bond has to cover another penalty
    function forgive(ServiceId serviceId, address provider) external;

    /// @notice The organization vouches for the provider, or does no longer. Only the service manager.
    /// @param vouched whether it does
    /// @return changed whether it is proven now and was not before, or the other way round
    function vouch(address provider, bool vouched) external returns (bool changed);

    /// @notice Have payments for the provider's work, and its bonds and stakes, go to another address. A provider names
    /// one once. Then only that address can name the next, so that whoever takes the provider's key cannot take what
    /// it earns. Applies to whatever is paid from now on. What a creator has back of its rewards stays with the creator.
    /// @param provider whose payments go there; the caller has to be its payout address
    /// @param payout who is paid; the provider's own address gives the right to choose back to the provider
    function setPayout(address provider, address payout) external;

    /// @notice Remember who owns a device: what one does for the other does not count for its reputation. Only the
    /// organization, which registers devices.
    /// @param device the device's key
    /// @param owner the participant that owns the device
    function recordOwner(address device, address owner) external;

    /// @notice Returns whether an account is proven: three of its attempts at tasks of others were accepted, for two creators at
    /// least, or all for the organization, or the organization vouches for it, as it does for members.
    function isProven(address account) external view returns (bool);

    /// @notice Reverts with ProviderIsAsleep or BondExhausted unless the service may become active.
    function requireReady(ServiceId serviceId, address provider) external view;

    /// @notice Reverts with NotNamable or TooManyVoids unless the creator may post a task that names the service. Whoever is
    /// related to the provider may.
    /// @param creator who posts the task
    /// @param voids how many of 100 tasks of the creator that named somebody ended void
    function requireNamable(ServiceId serviceId, address creator, uint256 voids) external view;

    /// @notice Returns what a service agreed to.
    function agreementOf(ServiceId serviceId) external view returns (Agreement memory);

    /// @notice Returns whether a provider is not proven and has to rest.
    function rests(address provider) external view returns (bool);

    /// @notice Returns until when a provider rests, or when one that fell asleep may wake up; 0 for others.
    function asleepUntil(address provider) external view returns (uint256);

    /// @notice Returns until when the bonds of a provider stay locked that is not proven and has given work back or missed it,
    /// whatever was accepted since then; in the past for others.
    function lockedUntil(address provider) external view returns (uint256);

    /// @notice Returns the reputation of a provider, 0 .. 63, see IServiceManager.Service, its grade by which waiting services
    /// are compared, and its failures in a row.
    function recordOf(address provider)
        external
        view
        returns (uint64 reputation, uint64 grade, uint8 failures);

    /// @notice Returns who is paid what the contracts owe an account.
    function payoutOf(address account) external view returns (address);

    /// @notice Returns whether two accounts are the same, or one owns the other, or somebody owns both, as the organization's
    /// registry of devices knows.
    function areRelated(address account, address other) external view returns (bool);

    /// @notice Returns the first of `accounts` that would profit from a ruling: that is the creator or the provider, or is
    /// related to one of them.
    /// @param accounts who judges
    /// @param provider who does the task
    /// @param creator who posted it
    /// @return party the first of them that is one; 0 if none is
    function partyAmong(address[] calldata accounts, address provider, address creator)
        external
        view
        returns (address party);
}
